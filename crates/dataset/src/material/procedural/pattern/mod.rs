//! Regular structures: courses of bricks and planks, herringbone, woven threads, scattered shapes.

pub mod courses;
pub mod scatter;
pub mod weave;
