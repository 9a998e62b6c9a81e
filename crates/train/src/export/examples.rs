//! A generated scan: what the nets of an export are tried on. The same in every export.

use burn::tensor::{Device, Tensor};
use dataset::exemplar::Exemplar;
use dataset::material::library::{ProceduralConfig, SourceConfig};
use dataset::material::{MaterialLibrary, Split};
use dataset::pair::{FlowPair, PairConfig};
use dataset::sequence::{Sequence, SequenceConfig};
use dataset::stream::Stream;
use flow::weights::DISTANT;
use ops::planes::{Mask, Planes};

use super::ExportError;

/// Side of the images, in pixels.
pub const SIDE: usize = 128;
/// Key frames of the scan, as frames of its video.
const KEY_FRAMES: [usize; 2] = [30, 60];
/// Side of the frames that pairs are cut from, as in training.
const FRAME: usize = 256;
/// Texels of a generated tile.
const TEXELS: usize = 512;
const SEED: u64 = 1;

/// A pair per flow net and a scan for the SVBRDF net.
pub struct Examples {
    adjacent: FlowPair,
    distant: FlowPair,
    scan: Exemplar,
}

impl Examples {
    /// Renders them.
    pub fn new() -> Result<Self, ExportError> {
        let fail = |error: &dyn std::fmt::Display| ExportError::Example(error.to_string());
        let generated = ProceduralConfig { size: TEXELS, ..ProceduralConfig::default() };
        let library = MaterialLibrary::open(&[SourceConfig::Procedural(generated)], SEED, 0).map_err(|e| fail(&e))?;
        let material = library.material(Split::Test, 0).map_err(|e| fail(&e))?;
        let streams = Stream::new(SEED);
        let video = |config: &SequenceConfig| Sequence::new(material.clone(), config, &streams, 0);
        let (moving, scanned) = (video(&SequenceConfig::flow()), video(&SequenceConfig::svbrdf()));
        let config = PairConfig { resolution: FRAME, crop: SIDE, augment: false };
        let mut rng = streams.rng("pair", 0);
        Ok(Self {
            adjacent: FlowPair::adjacent(&moving, moving.len() / 2, &config, &mut rng).map_err(|e| fail(&e))?,
            distant: FlowPair::distant(&moving, &config, &mut rng).map_err(|e| fail(&e))?,
            scan: Exemplar::of(&scanned, 0, &KEY_FRAMES, SIDE),
        })
    }

    /// The inputs of a net by name, in the order in which it takes them.
    pub fn of(&self, name: &str, kind: &str, device: &Device) -> Vec<(&'static str, Tensor<4>)> {
        let batch = |planes: &[Planes]| Planes::batch(&planes.iter().collect::<Vec<_>>(), device);
        if kind == svbrdf::weights::KIND {
            let valid: Vec<Planes> = self.scan.valid.iter().map(Mask::to_planes).collect();
            let flows: Vec<Planes> = self.scan.flows.iter().map(finite).collect();
            return vec![("frames", batch(&self.scan.frames)), ("flow", batch(&flows)), ("valid", batch(&valid))];
        }
        let pair = if name == DISTANT { &self.distant } else { &self.adjacent };
        vec![("first", pair.first.to_tensor(device)), ("second", pair.second.to_tensor(device))]
    }
}

/// Flow without NaN: the mask says where it counts.
fn finite(flow: &Planes) -> Planes {
    let data = flow.data.iter().map(|v| if v.is_finite() { *v } else { 0.0 }).collect();
    Planes { data, ..flow.clone() }
}
