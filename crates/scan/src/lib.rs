//! Floor 3: from a clip to a material on disk (paper §3, Fig. 1).
//!
//! [`nets`] are the trained nets, [`reconstruct`] goes from frames to maps, [`guidance`] moves them to a photo's axes, [`export`] writes maps and what other programs need
//! to know about them, [`report`] shows how the capture went; [`html`] is
//! what reports in single HTML files have in common.

mod camera_json;
pub mod export;
pub mod guidance;
pub mod html;
pub mod nets;
pub mod output;
pub mod reconstruct;
pub mod report;
pub mod settings;
