//! The method under test: its nets and how it uses them.

use std::path::Path;

use burn::tensor::Device;
use dataset::exemplar::Exemplar;
use flow::align::{AlignConfig, Aligner, FlowEstimator};
use flow::pwc::Pwc;
use ops::planes::{Mask, Planes};
use render::svbrdf::SvbrdfImage;
use svbrdf::net::SvbrdfNet;
use svbrdf::net::fusion::KeyFrame;

use crate::EvaluateError;

/// The three trained nets; the flow nets may be absent, the alignment then works with its classical candidates alone.
#[derive(Debug)]
pub struct Method {
    /// For neighbouring frames.
    pub adjacent: Option<Pwc>,
    /// For a roughly aligned key frame and the guidance image.
    pub distant: Option<Pwc>,
    /// From aligned frames to maps.
    pub svbrdf: SvbrdfNet,
    /// Where the nets run.
    pub device: Device,
}

impl Method {
    /// Reads all three nets from a folder of weights.
    ///
    /// # Errors
    /// If a file is missing, broken or doesn't fit its architecture.
    pub fn load(folder: &Path, device: &Device) -> Result<Self, EvaluateError> {
        let nets = flow::weights::FlowNets::load(folder, device)?;
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

    /// Maps of the guidance frame from key frames and their warps.
    ///
    /// # Errors
    /// If sizes differ.
    pub fn maps(&self, guidance: &Planes, keys: impl IntoIterator<Item = KeyFrame>) -> Result<SvbrdfImage, EvaluateError> {
        Ok(self.svbrdf.reconstruct(guidance, keys, &self.device)?)
    }

    /// Maps of an exemplar with its exact warps.
    ///
    /// # Errors
    /// If sizes differ.
    pub fn maps_of_exemplar(&self, exemplar: &Exemplar) -> Result<SvbrdfImage, EvaluateError> {
        let keys = exemplar.frames[1..].iter().zip(&exemplar.flows).zip(&exemplar.valid);
        let keys = keys.map(|((frame, flow), valid)| key_frame(frame.clone(), flow.clone(), valid.clone()));
        self.maps(&exemplar.frames[0], keys)
    }
}

/// A key frame with its warp.
pub fn key_frame(frame: Planes, flow: Planes, valid: Mask) -> KeyFrame {
    KeyFrame { frame, flow, valid: Some(valid) }
}
