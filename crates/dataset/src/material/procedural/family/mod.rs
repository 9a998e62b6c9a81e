//! The families, grouped by substance.

pub mod coated_metal;
pub mod ground;
pub mod hide;
pub mod masonry;
pub mod metal;
pub mod mineral;
pub mod plastic;
pub mod roof;
pub mod sheet;
pub mod stone;
pub mod textile;
pub mod tile;
pub mod wood;
