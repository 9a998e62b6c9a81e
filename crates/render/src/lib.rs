//! Floor 1: what a camera with a flash sees of a flat material, and how that depends on the material's maps.
//!
//! # Axes (stated once for the whole workspace, tested in [`camera`])
//!
//! ```text
//!   world                         image of resolution w × h          tangent space of the maps
//!        y up                     (0,0)──► x right                        +y up (OpenGL)
//!        ▲                          │  pixel centres at integers          ▲
//!        │                          ▼  principal point ((w−1)/2, (h−1)/2) │
//!        ⊙──► x right               y down                                ⊙──► +x right
//!     z towards the viewer                                             +z towards the viewer
//! ```
//!
//! - The material lies on z = 0 over [−1, 1]²; its tangent space is the world's axes. World x = −1 is the left edge of
//!   texel 0 and y = +1 the upper edge of row 0: texel x = (X + 1)/2·S − ½, texel y = (1 − Y)/2·S − ½.
//! - A camera's axes are (right, down, forward); the normal axes of the maps that a camera sees are (right, up, to the
//!   camera) = (right, −down, −forward), see [`camera::Camera::normal_to_camera`].
//! - wi points to the light, wo to the viewer, h is their half vector; all unit vectors that leave the surface.
//! - Roughness is perceptual r in [0, 1], alpha = r²; albedos are linear.
//!
//! # Routes
//! One meaning, three implementations: [`pixel`] (one pixel, plain `f32`; [`block`] does sixteen of them for frames), [`shade`] (tensors, any
//! device, differentiable: the readable reference) and [`fused`] (value and gradient of the rendering losses in one pass on
//! the CPU). Tests hold them together.

mod approximation;
pub mod block;
pub mod brdf;
pub mod camera;
pub mod direction;
pub mod environment;
pub mod evaluation;
pub mod fused;
pub mod lens;
pub mod light;
pub mod loss;
pub mod pixel;
pub mod sensor;
pub mod shade;
pub mod svbrdf;
pub mod texel;
pub mod views;
pub mod visual;
