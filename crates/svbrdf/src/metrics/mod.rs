//! What the maps are judged by (spec 6.1).

pub mod maps;
pub mod rendering;
pub mod ssim;

pub use maps::MapErrors;
pub use rendering::RenderErrors;
pub use ssim::ssim;
