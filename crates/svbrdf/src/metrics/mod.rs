//! What the maps are judged by (spec 6.1).

pub mod maps;
pub mod ssim;

pub use maps::MapErrors;
pub use ssim::ssim;
