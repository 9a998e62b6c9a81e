//! Constant maps: the baseline every learnt map is measured against, and where the net's outputs may start.

use render::svbrdf::SvbrdfImage;
use render::texel::Texel;
use serde::{Deserialize, Serialize};

/// Outputs of the net: nx, ny, diffuse ×3, roughness, specular ×3.
pub const OUTPUTS: usize = 9;
/// Outputs start no nearer to ±1 than this, where tanh still passes a tenth of the gradient.
const STEEPEST_START: f32 = 0.95;
/// Pixels of a target that enter the medians, at most.
const SAMPLES_PER_TARGET: usize = 1024;

/// One value per map, with the normal (0, 0, 1).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ConstantMaps {
    /// Diffuse albedo, linear.
    pub diffuse: [f32; 3],
    /// Perceptual roughness.
    pub roughness: f32,
    /// Specular albedo, linear.
    pub specular: [f32; 3],
}

impl ConstantMaps {
    /// Medians per channel over the targets, each with the same weight; `None` without a target.
    pub fn medians<'a>(targets: impl IntoIterator<Item = &'a SvbrdfImage>) -> Option<Self> {
        let mut values: [Vec<f32>; 7] = Default::default();
        for target in targets {
            let step = (target.roughness.data.len() / SAMPLES_PER_TARGET).max(1);
            let planes = (0..3).map(|c| target.diffuse.plane(c)).chain([target.roughness.plane(0)]);
            let planes = planes.chain((0..3).map(|c| target.specular.plane(c)));
            values.iter_mut().zip(planes).for_each(|(v, plane)| v.extend(plane.iter().step_by(step)));
        }
        if values[0].is_empty() {
            return None;
        }
        let [d0, d1, d2, r, s0, s1, s2] = values.map(median);
        Some(Self { diffuse: [d0, d1, d2], roughness: r, specular: [s0, s1, s2] })
    }

    /// The constants as maps of `height × width` pixels.
    pub fn to_image(&self, height: usize, width: usize) -> SvbrdfImage {
        let Self { diffuse, roughness, specular } = *self;
        SvbrdfImage::constant(height, width, &Texel { normal: [0.0, 0.0, 1.0], diffuse, roughness, specular })
    }

    /// The last layer's bias whose tanh gives these maps.
    pub fn output_bias(&self) -> [f32; OUTPUTS] {
        let start = |v: f32| (2.0 * v - 1.0).clamp(-STEEPEST_START, STEEPEST_START).atanh();
        let [d, s] = [self.diffuse, self.specular];
        [0.0, 0.0, start(d[0]), start(d[1]), start(d[2]), start(self.roughness), start(s[0]), start(s[1]), start(s[2])]
    }
}

fn median(mut values: Vec<f32>) -> f32 {
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f32::total_cmp).1
}
