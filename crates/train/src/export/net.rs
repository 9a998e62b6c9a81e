//! A net of either kind, with what goes in and comes out.

use std::path::Path;

use burn::tensor::{Device, Tensor};
use flow::pwc::Pwc;
use ops::weights::{MANIFEST, NetRecord, Port, Tensors, tensors_of};
use svbrdf::net::SvbrdfNet;

use super::ExportError;

/// A net that can be run.
pub enum Net {
    /// From two images to flow.
    Flow(Box<Pwc>),
    /// From aligned frames to maps.
    Svbrdf(Box<SvbrdfNet>),
}

/// What a net takes and gives.
pub struct Ports {
    /// In order.
    pub inputs: Vec<Port>,
    /// In order.
    pub outputs: Vec<Port>,
}

impl Net {
    /// Reads a net from a folder of weights.
    pub fn load(folder: &Path, name: &str, record: &NetRecord, device: &Device) -> Result<Self, ExportError> {
        match record.kind.as_str() {
            flow::weights::KIND => Ok(Self::Flow(Box::new(flow::weights::load(folder, name, device)?.0))),
            svbrdf::weights::KIND if name == svbrdf::weights::NAME => {
                Ok(Self::Svbrdf(Box::new(svbrdf::weights::load(folder, device)?.0)))
            }
            kind => Err(ExportError::Kind { path: folder.join(MANIFEST), net: name.into(), kind: kind.into() }),
        }
    }

    /// Its weights.
    pub fn tensors(&self) -> Tensors {
        match self {
            Self::Flow(net) => tensors_of(net.as_ref()),
            Self::Svbrdf(net) => tensors_of(net.as_ref()),
        }
    }

    /// Its output for the inputs of its ports.
    pub fn run(&self, inputs: &[(&'static str, Tensor<4>)]) -> Tensor<4> {
        let input = |index: usize| inputs[index].1.clone();
        match self {
            Self::Flow(net) => net.flow(input(0), input(1)),
            Self::Svbrdf(net) => net.forward(input(0), input(1), Some(input(2))).stacked(),
        }
    }

    /// What goes in and comes out, in the order of `forward` in PyTorch and here.
    pub fn ports(&self) -> Ports {
        let port =
            |name: &str, shape: &str, meaning: &str| Port { name: name.into(), shape: shape.into(), meaning: meaning.into() };
        match self {
            Self::Flow(_) => Ports {
                inputs: vec![
                    port("first", "N × 3 × H × W", "RGB in [0, 1], gamma-encoded as in image files; any height and width"),
                    port("second", "N × 3 × H × W", "the same, of another frame"),
                ],
                outputs: vec![port(
                    "flow",
                    "N × 2 × H × W",
                    "(x, y) in pixels, x right and y down: what `first` shows at a pixel p lies at p + flow in `second`",
                )],
            },
            Self::Svbrdf(_) => Ports {
                inputs: vec![
                    port(
                        "frames",
                        "(K + 1) × 3 × H × W",
                        "RGB in [0, 1], gamma-encoded; the guidance frame, then K key frames",
                    ),
                    port(
                        "flow",
                        "K × 2 × H × W",
                        "(x, y) in pixels, pixel centres at integers: what the guidance frame shows at a pixel p lies at p + flow in the key frame",
                    ),
                    port(
                        "valid",
                        "K × 1 × H × W",
                        "how surely the key frame shows the pixel, in [0, 1]; below 0.5 it takes no part",
                    ),
                ],
                outputs: vec![port(
                    "maps",
                    "1 × 10 × H × W",
                    "normal (3, unit length in [-1, 1]: +x right, +y up, +z to the viewer), diffuse albedo (3, linear RGB in [0, 1]), roughness (1, perceptual: alpha = r²), specular albedo (3, linear RGB in [0, 1])",
                )],
            },
        }
    }
}
