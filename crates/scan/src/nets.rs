//! The three trained nets of a scan and how they are used.

use std::path::Path;

use burn::tensor::Device;
use flow::align::{AlignConfig, Aligner, FlowEstimator};
use flow::pwc::Pwc;
use flow::weights::FlowNets;
use ops::planes::{Mask, Planes};
use ops::weights::WeightsError;
use render::svbrdf::SvbrdfImage;
use svbrdf::net::SvbrdfNet;
use svbrdf::net::fusion::{FusionError, KeyFrame};

/// The nets; the flow nets may be absent, the alignment then works with its classical candidates alone.
#[derive(Debug)]
pub struct ScanNets {
    /// For neighbouring frames.
    pub adjacent: Option<Pwc>,
    /// For a roughly aligned key frame and the guidance image.
    pub distant: Option<Pwc>,
    /// From aligned frames to maps.
    pub svbrdf: SvbrdfNet,
    /// Where the nets run.
    pub device: Device,
}

impl ScanNets {
    /// Reads all three nets from a folder of weights.
    ///
    /// # Errors
    /// If a file is missing, broken or doesn't fit its architecture.
    pub fn load(folder: &Path, device: &Device) -> Result<Self, WeightsError> {
        let nets = FlowNets::load(folder, device)?;
        let (svbrdf, _) = svbrdf::weights::load(folder, device)?;
        Ok(Self { adjacent: Some(nets.adjacent), distant: Some(nets.distant), svbrdf, device: device.clone() })
    }

    /// The aligner with these nets.
    pub fn aligner(&self, config: AlignConfig) -> Aligner<'_> {
        fn estimator(net: &Pwc) -> &dyn FlowEstimator {
            net
        }
        Aligner { config, adjacent: self.adjacent.as_ref().map(estimator), distant: self.distant.as_ref().map(estimator) }
    }

    /// Maps of the guidance frame from key frames and their warps, one key frame in memory at a time.
    ///
    /// # Errors
    /// If sizes differ.
    pub fn maps(&self, guidance: &Planes, keys: impl IntoIterator<Item = KeyFrame>) -> Result<SvbrdfImage, FusionError> {
        self.svbrdf.reconstruct(guidance, keys, &self.device)
    }
}

/// A key frame with its warp.
pub fn key_frame(frame: Planes, (flow, valid): (Planes, Mask)) -> KeyFrame {
    KeyFrame { frame, flow, valid: Some(valid.to_planes()) }
}
