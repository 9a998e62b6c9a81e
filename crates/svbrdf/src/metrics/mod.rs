//! What the maps are judged by (spec 6.1).

pub mod maps;
pub mod rendering;
pub mod spikes;
pub mod ssim;

pub use maps::MapErrors;
pub use rendering::RenderErrors;
pub use spikes::Spikes;
pub use ssim::ssim;
