//! svbrdf
