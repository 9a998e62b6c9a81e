//! Bad input through the real programs: each case must end with the right exit code and a message that says what to do,
//! without a panic and without leaving anything behind.

mod case;
mod evaluate;
mod input;
mod scan;
