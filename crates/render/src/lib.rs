//! render

pub mod texel;
