//! The maps of one material at full precision, as a generator or a file reader hands them over.

use ops::planes::Planes;

/// The four maps of a material in `f32`, before they are quantised for storage.
///
/// All planes have the same height and width. Normals are unit vectors in tangent space, +x right, +y up (OpenGL), +z to
/// the viewer; row 0 is the top row. Albedos are linear in [0, 1]; roughness is perceptual (alpha = r²) in [0, 1].
#[derive(Clone, Debug, PartialEq)]
pub struct MaterialMaps {
    /// Unit normals, 3 channels.
    pub normal: Planes,
    /// Linear diffuse albedo, 3 channels.
    pub diffuse: Planes,
    /// Perceptual roughness, 1 channel.
    pub roughness: Planes,
    /// Linear specular albedo (reflectance at normal incidence), 3 channels.
    pub specular: Planes,
    /// Height above the mean plane in texels, 1 channel, where the source has one.
    pub height_field: Option<Planes>,
}

impl MaterialMaps {
    /// Columns of every map.
    pub fn width(&self) -> usize {
        self.roughness.width
    }

    /// Rows of every map.
    pub fn height(&self) -> usize {
        self.roughness.height
    }
}
