//! The pinhole camera of the scanning sequences and its exact map between the material's plane and an image.
//!
//! Camera axes are (right, down, forward); focal length = 0.5·res/tan(fov/2) pixels; the principal point is the image
//! centre ((res−1)/2, (res−1)/2) with pixel centres at integers. See the crate's page for the picture.

use nalgebra::Matrix3;
use ops::homography::Homography;
use serde::{Deserialize, Serialize};

/// A pinhole camera with square images.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Camera {
    /// Centre of projection in world coordinates.
    pub position: [f64; 3],
    /// Unit vector along the image's x axis.
    pub right: [f64; 3],
    /// Unit vector along the image's y axis, which points down.
    pub down: [f64; 3],
    /// Unit vector along the optical axis, into the scene.
    pub forward: [f64; 3],
    /// Full field of view across the image's width, edge to edge.
    pub fov_rad: f64,
}

impl Camera {
    /// A camera at `position` whose optical axis goes through `target`, rolled so that `up` appears upright.
    ///
    /// # Panics
    /// If `position` = `target` or `up` is parallel to the optical axis.
    pub fn look_at(position: [f64; 3], target: [f64; 3], up: [f64; 3], fov_rad: f64) -> Self {
        let forward = unit(sub(target, position));
        let right = unit(cross(forward, up));
        let down = cross(forward, right);
        assert!(right.iter().chain(&forward).all(|v| v.is_finite()), "the camera needs a target and an up of its own");
        Self { position, right, down, forward, fov_rad }
    }

    /// Focal length in pixels of an image with `res` columns.
    pub fn focal_px(&self, res: usize) -> f64 {
        0.5 * res as f64 / (0.5 * self.fov_rad).tan()
    }

    /// The plane z = 0 to the image: world (x, y) to pixel (x, y).
    pub fn world_to_pixel(&self, res: usize) -> Homography {
        let (focal, centre) = (self.focal_px(res), (res as f64 - 1.0) / 2.0);
        let row = |axis: [f64; 3]| [axis[0], axis[1], -dot(axis, self.position)];
        let (x, y, depth) = (row(self.right), row(self.down), row(self.forward));
        let mix = |a: [f64; 3]| std::array::from_fn::<f64, 3, _>(|i| focal * a[i] + centre * depth[i]);
        let (u, v) = (mix(x), mix(y));
        positive(Matrix3::new(u[0], u[1], u[2], v[0], v[1], v[2], depth[0], depth[1], depth[2]))
    }

    /// Pixel (x, y) to world (x, y) on the plane z = 0.
    ///
    /// # Panics
    /// If the plane z = 0 contains the camera.
    pub fn pixel_to_world(&self, res: usize) -> Homography {
        let inverse = self.world_to_pixel(res).matrix.try_inverse();
        positive(inverse.expect("a camera outside the plane z = 0 maps it one to one"))
    }

    /// The flow between two frames: target pixel to the source pixel that shows the same surface point.
    pub fn between(target: &Self, source: &Self, res: usize) -> Homography {
        positive(source.world_to_pixel(res).matrix * target.pixel_to_world(res).matrix)
    }

    /// The camera on the way from this one (share 0, exactly) to `next` (share 1): position and axes move linearly, and the axes
    /// are made orthonormal again. Other shares go on in the same direction.
    ///
    /// # Panics
    /// If the two look in opposite directions.
    pub fn towards(&self, next: &Self, share: f64) -> Self {
        if share == 0.0 {
            return *self;
        }
        let mix = |a: [f64; 3], b: [f64; 3]| std::array::from_fn::<f64, 3, _>(|k| a[k] + share * (b[k] - a[k]));
        let (position, forward, down) =
            (mix(self.position, next.position), mix(self.forward, next.forward), mix(self.down, next.down));
        let target = std::array::from_fn(|k| position[k] + forward[k]);
        let fov_rad = self.fov_rad + share * (next.fov_rad - self.fov_rad);
        Self::look_at(position, target, down.map(|v| -v), fov_rad)
    }

    /// The camera turned about its optical axis; for a positive angle the picture turns to the left. Angle 0 is exactly `self`.
    pub fn rolled(&self, angle_rad: f64) -> Self {
        let (sin, cos) = angle_rad.sin_cos();
        let mix = |a: [f64; 3], b: [f64; 3]| std::array::from_fn(|k| cos * a[k] + sin * b[k]);
        Self { right: mix(self.right, self.down), down: mix(self.down, self.right.map(|v| -v)), ..*self }
    }

    /// Unit direction from the camera through a pixel, in world coordinates.
    pub fn ray(&self, x: f64, y: f64, res: usize) -> [f64; 3] {
        let (focal, centre) = (self.focal_px(res), (res as f64 - 1.0) / 2.0);
        let (a, b) = ((x - centre) / focal, (y - centre) / focal);
        unit(std::array::from_fn(|i| a * self.right[i] + b * self.down[i] + self.forward[i]))
    }

    /// Rows of the rotation that takes a world-space normal to the axes of the maps this camera sees: x right, y up, z to
    /// the camera.
    pub fn normal_to_camera(&self) -> [[f32; 3]; 3] {
        let negated = |a: [f64; 3]| a.map(|v| -v as f32);
        [self.right.map(|v| v as f32), negated(self.down), negated(self.forward)]
    }

    /// The camera's position in `f32`, as the shading routes take it.
    pub fn eye(&self) -> [f32; 3] {
        self.position.map(|v| v as f32)
    }
}

/// Scaled by a *positive* number only: the sign of the third coordinate tells what lies behind the camera, and dividing by
/// a negative last entry would turn it around.
fn positive(matrix: Matrix3<f64>) -> Homography {
    Homography { matrix: matrix / matrix[(2, 2)].abs().max(1e-9 * matrix.norm()) }
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn sub(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn unit(a: [f64; 3]) -> [f64; 3] {
    let length = dot(a, a).sqrt();
    a.map(|v| v / length)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tilted() -> Camera {
        Camera::look_at([0.2, -0.1, 0.25], [0.23, -0.13, 0.0], [0.05, 1.0, 0.0], 0.5)
    }

    #[test]
    fn axes_of_a_camera_above_the_origin() {
        let camera = Camera::look_at([0.0, 0.0, 2.0], [0.0; 3], [0.0, 1.0, 0.0], std::f64::consts::FRAC_PI_2);
        assert_eq!(camera.right, [1.0, 0.0, 0.0]);
        assert_eq!(camera.down, [0.0, -1.0, 0.0]);
        assert_eq!(camera.forward, [0.0, 0.0, -1.0]);
        // fov 90° at height 2 sees [−2, 2]: world (−2, 2) is the upper-left *edge*, half a pixel outside pixel (0, 0).
        let (x, y) = camera.world_to_pixel(64).apply(-2.0, 2.0).unwrap();
        assert!((x + 0.5).abs() < 1e-9 && (y + 0.5).abs() < 1e-9);
        let (x, y) = camera.world_to_pixel(64).apply(0.0, 0.0).unwrap();
        assert!((x - 31.5).abs() < 1e-9 && (y - 31.5).abs() < 1e-9);
        assert_eq!(camera.normal_to_camera(), [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]);
    }

    #[test]
    fn a_roll_turns_the_picture_about_its_centre() {
        let camera = tilted();
        assert_eq!(camera.rolled(0.0), camera);
        // A quarter turn to the left: what was at the right edge is now at the top.
        let turn = Camera::between(&camera, &camera.rolled(std::f64::consts::FRAC_PI_2), 65);
        let (x, y) = turn.apply(64.0, 32.0).unwrap();
        assert!((x - 32.0).abs() < 1e-9 && y.abs() < 1e-9, "{x} {y}");
    }

    #[test]
    fn the_homography_is_ray_casting() {
        let camera = tilted();
        let to_world = camera.pixel_to_world(256);
        for (px, py) in [(0.0, 0.0), (255.0, 0.0), (13.25, 201.5), (127.5, 127.5)] {
            let d = camera.ray(px, py, 256);
            let t = -camera.position[2] / d[2];
            let hit = (camera.position[0] + t * d[0], camera.position[1] + t * d[1]);
            let (x, y) = to_world.apply(px, py).unwrap();
            assert!((x - hit.0).abs() < 1e-12 && (y - hit.1).abs() < 1e-12);
            let (u, v) = camera.world_to_pixel(256).apply(x, y).unwrap();
            assert!((u - px).abs() < 1e-8 && (v - py).abs() < 1e-8);
        }
        assert!(camera.world_to_pixel(256).apply(0.0, 1e6).is_none_or(|(_, v)| v < 128.0));
    }

    #[test]
    fn a_camera_that_looks_away_from_the_origin_still_sees_its_own_plane() {
        // The origin lies behind this camera, so the homography's last entry is negative before scaling.
        let camera = Camera::look_at([0.5, 0.0, 0.1], [0.9, 0.0, 0.0], [0.0, 1.0, 0.0], 0.5);
        let (x, _) = camera.world_to_pixel(64).apply(0.9, 0.0).unwrap();
        assert!((x - 31.5).abs() < 1e-9);
        assert!(camera.world_to_pixel(64).apply(0.0, 0.0).is_none());
        let (x, y) = camera.pixel_to_world(64).apply(31.5, 31.5).unwrap();
        assert!((x - 0.9).abs() < 1e-9 && y.abs() < 1e-9);
    }

    #[test]
    fn flow_between_frames_follows_the_surface() {
        let (a, b) = (tilted(), Camera::look_at([0.24, -0.08, 0.22], [0.25, -0.1, 0.0], [-0.02, 1.0, 0.0], 0.5));
        let h = Camera::between(&a, &b, 128);
        let (wx, wy) = a.pixel_to_world(128).apply(20.0, 90.0).unwrap();
        let expected = b.world_to_pixel(128).apply(wx, wy).unwrap();
        let got = h.apply(20.0, 90.0).unwrap();
        assert!((got.0 - expected.0).abs() < 1e-8 && (got.1 - expected.1).abs() < 1e-8);
        let same = Camera::between(&a, &a, 128).apply(7.0, 11.0).unwrap();
        assert!((same.0 - 7.0).abs() < 1e-9 && (same.1 - 11.0).abs() < 1e-9);
    }

    #[test]
    fn a_camera_moves_from_one_pose_to_the_next() {
        let (a, b) = (tilted(), Camera::look_at([0.24, -0.08, 0.22], [0.25, -0.1, 0.0], [-0.02, 1.0, 0.0], 0.5));
        assert_eq!(a.towards(&b, 0.0), a);
        let (end, middle, beyond) = (a.towards(&b, 1.0), a.towards(&b, 0.5), a.towards(&b, -1.0));
        let dot = |u: [f64; 3], v: [f64; 3]| (0..3).map(|k| u[k] * v[k]).sum::<f64>();
        for k in 0..3 {
            assert!((end.position[k] - b.position[k]).abs() < 1e-12 && (end.down[k] - b.down[k]).abs() < 1e-12);
            assert!((middle.position[k] - 0.5 * (a.position[k] + b.position[k])).abs() < 1e-12);
            assert!((beyond.position[k] - (2.0 * a.position[k] - b.position[k])).abs() < 1e-12);
        }
        assert!((dot(middle.right, middle.right) - 1.0).abs() < 1e-12 && dot(middle.right, middle.forward).abs() < 1e-12);
        let angle = |c: &Camera| dot(c.forward, b.forward).clamp(-1.0, 1.0).acos();
        assert!((angle(&middle) / angle(&a) - 0.5).abs() < 1e-2);
    }

    #[test]
    fn normals_turn_into_the_camera_axes() {
        let camera = tilted();
        let to_camera = camera.position.iter().zip([0.23, -0.13, 0.0]).map(|(p, t)| (p - t) as f32);
        let to_camera: Vec<f32> = to_camera.collect();
        let length = to_camera.iter().map(|v| v * v).sum::<f32>().sqrt();
        let rows = camera.normal_to_camera();
        let z = (0..3).map(|i| rows[2][i] * to_camera[i] / length).sum::<f32>();
        assert!((z - 1.0).abs() < 1e-6);
        assert!(rows[1][1] > 0.9, "up stays up");
    }
}
