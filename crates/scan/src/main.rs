//! scan
fn main() {}
