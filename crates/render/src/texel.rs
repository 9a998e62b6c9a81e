//! One point of a material.

/// The reflectance of one surface point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Texel {
    /// Unit normal, +x right, +y up, +z to the viewer.
    pub normal: [f32; 3],
    /// Linear diffuse albedo.
    pub diffuse: [f32; 3],
    /// Perceptual roughness r; alpha = r².
    pub roughness: f32,
    /// Linear specular albedo (reflectance at normal incidence).
    pub specular: [f32; 3],
}

impl Texel {
    /// A point of a flat, unpolished, non-metallic surface with the given diffuse albedo.
    pub fn matte(diffuse: [f32; 3]) -> Self {
        Self { normal: [0.0, 0.0, 1.0], diffuse, roughness: 1.0, specular: [0.04; 3] }
    }
}
