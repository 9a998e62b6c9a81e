//! Floor 2: from aligned frames to reflectance maps (paper §6).
//!
//! [`net`] is the SVBRDF net: per-frame features, warped into the guidance frame, reduced by a masked maximum (or another
//! [`net::Pooling`]) and decoded into maps. [`loss`] is what it learns from, [`metrics`] what it is judged by, [`constants`] the
//! constant maps it starts from and is compared with, [`visual`] its previews and [`weights`] its files.

pub mod constants;
pub mod loss;
pub mod metrics;
pub mod net;
pub mod visual;
pub mod weights;
