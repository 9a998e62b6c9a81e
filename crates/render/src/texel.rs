//! The reflectance at one place of a material.

/// Normal, albedos and roughness at one place: the scalar counterpart of a pixel of the SVBRDF maps.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Texel {
    /// Unit normal in tangent space: +x right, +y up, +z to the viewer.
    pub normal: [f32; 3],
    /// Linear diffuse albedo.
    pub diffuse: [f32; 3],
    /// Perceptual roughness r; alpha = r².
    pub roughness: f32,
    /// Linear specular albedo: reflectance at normal incidence.
    pub specular: [f32; 3],
}
