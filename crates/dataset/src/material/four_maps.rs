//! Normal, diffuse, roughness and specular in one file, three numbers each: the layout that [`super::inria`] and
//! [`super::npy`] share.

use render::texel::Texel;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::decoding::{self, ColourTable};
use super::error::MaterialError;
use super::stored::{Material, MaterialInfo};
use crate::image_io::Samples;

/// How a file stores its albedos. Versions of one data set differ in it and no file says which it is, so the config must:
/// read the wrong way, every albedo is too dark or too bright.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum AlbedoEncoding {
    /// Stored = linear^(1/2.2), as pictures are: greys look evenly spaced in an image viewer.
    Gamma,
    /// Stored = linear: looks too dark in an image viewer.
    Linear,
}

impl AlbedoEncoding {
    fn decode(self) -> fn(f32) -> f32 {
        match self {
            Self::Gamma => ops::colour::gamma_decode,
            Self::Linear => |stored| stored,
        }
    }
}

/// How far apart numbers of a file are.
#[derive(Clone, Copy, Debug)]
pub(super) struct Strides {
    /// From a texel to the one on its right.
    pub column: usize,
    /// From a texel to the one below.
    pub row: usize,
    /// From a texel of one map to the same texel of the next.
    pub map: usize,
}

/// The numbers of a file and what they mean.
pub(super) struct FourMaps {
    pub samples: Samples,
    pub width: usize,
    pub height: usize,
    pub strides: Strides,
    pub albedo: AlbedoEncoding,
    /// Whether the roughness is the square of what is stored.
    pub roughness_squared: bool,
}

impl FourMaps {
    /// Converts the maps to a material. Normals have +y up (OpenGL); roughness, stored three times, is read from red.
    ///
    /// # Errors
    /// As [`Material::build`].
    pub(super) fn build(&self, info: MaterialInfo) -> Result<Material, MaterialError> {
        let colours = ColourTable::new(&self.samples, self.albedo.decode());
        let precision = decoding::precision(std::iter::once(&self.samples));
        Material::build(info, self.width, self.height, precision, |x, y| {
            let [normal, diffuse, roughness, specular] =
                std::array::from_fn(|map| y * self.strides.row + x * self.strides.column + map * self.strides.map);
            let roughness = self.samples.share(roughness);
            Texel {
                normal: decoding::normal(&self.samples, normal, false),
                diffuse: colours.rgb(&self.samples, diffuse, 3),
                roughness: if self.roughness_squared { roughness * roughness } else { roughness },
                specular: colours.rgb(&self.samples, specular, 3),
            }
        })
    }
}

#[cfg(test)]
mod tests;
