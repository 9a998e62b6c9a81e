//! Maps on disk, in the conventions of the programs that use them.

pub mod maps;
pub mod metalness;
