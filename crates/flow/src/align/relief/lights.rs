//! Where the light stood over the surface in every frame.

use nalgebra::Matrix3;
use ops::homography::Homography;

use crate::align::camera::ScanCamera;
use crate::align::scan::Scan;
use crate::align::size::Size;
use crate::align::track::Placed;

/// Half the field of view as a slope where no camera is known: a phone's.
const USUAL_SLOPE: f64 = 0.6;

/// Where the light of every node stands over the surface.
pub(super) struct Lights {
    /// Pixel of the guidance image, at the size of the links, to position on the surface.
    pub to_surface: Matrix3<f64>,
    /// Position over the surface, height last, in the same unit.
    pub positions: Vec<Option<[f64; 3]>>,
    /// Pixels of the guidance image per unit of slope.
    pub focal_px: f64,
}

impl Lights {
    /// At the cameras.
    pub fn of(scan: &Scan, camera: &ScanCamera) -> Option<Self> {
        let first = camera.poses.iter().find(|p| p.frame == 0)?;
        let focal_px = camera.focal_px * scan.sizes[0].width as f64 / scan.full[0].width as f64;
        let Size { height, width } = scan.sizes[0];
        let (cx, cy) = (0.5 * (width as f64 - 1.0), 0.5 * (height as f64 - 1.0));
        // The ray of a pixel, linear in (x, y, 1), and where it meets the surface z = 0.
        let ray = |k: usize| {
            let (right, down) = (first.right[k] / focal_px, first.down[k] / focal_px);
            nalgebra::RowVector3::new(right, down, first.forward[k] - cx * right - cy * down)
        };
        let meets = |k: usize| ray(2) * first.position[k] - ray(k) * first.position[2];
        let to_surface = Matrix3::from_rows(&[meets(0), meets(1), ray(2)]);
        let mut positions = vec![None; scan.sizes.len()];
        for pose in &camera.poses {
            let node = if pose.frame == 0 { Some(0) } else { scan.keys.iter().position(|&k| k == pose.frame).map(|i| i + 1) };
            if let Some(node) = node {
                positions[node] = Some(pose.position);
            }
        }
        Some(Self { to_surface, positions, focal_px })
    }

    /// Straight over what the middle of each frame shows, at one height: as if no camera were tilted.
    pub fn under_frames(scan: &Scan, placed: &Placed) -> Option<Self> {
        let height = 0.5 * scan.sizes[0].width as f64 / USUAL_SLOPE;
        let middle = |node: usize| {
            let Size { height, width } = scan.sizes[node];
            (0.5 * (width as f64 - 1.0), 0.5 * (height as f64 - 1.0))
        };
        let under = |(node, place): (usize, &Option<crate::align::graph::Place>)| {
            let (cx, cy) = middle(node);
            let (x, y) = place.as_ref()?.homography.inverse()?.apply(cx, cy)?;
            Some([x, y, height])
        };
        let positions = placed.places.iter().enumerate().map(under).collect();
        Some(Self { to_surface: Matrix3::identity(), positions, focal_px: height })
    }

    /// A node's homography if the scan's displacements were longer by the share `longer` of what relief makes of the light's
    /// way since the guidance frame.
    pub fn slid(&self, node: usize, homography: &Homography, longer: f64) -> Option<Homography> {
        let ([x0, y0, z0], [x, y, z]) = (self.positions[0]?, self.positions[node]?);
        let reach = longer * z0;
        let scale = 1.0 - reach * (1.0 / z - 1.0 / z0);
        let slide = Matrix3::new(scale, 0.0, reach * (x / z - x0 / z0), 0.0, scale, reach * (y / z - y0 / z0), 0.0, 0.0, 1.0);
        let on_pixels = self.to_surface.try_inverse()? * slide * self.to_surface;
        Some(Homography::new(homography.matrix * on_pixels))
    }

    /// The way of the light between two nodes, in pixels of the guidance image.
    pub fn way_px(&self, from: usize, to: usize) -> f64 {
        let way = |a: [f64; 3], b: [f64; 3]| (a[0] / a[2] - b[0] / b[2]).hypot(a[1] / a[2] - b[1] / b[2]);
        self.positions[from].zip(self.positions[to]).map_or(0.0, |(a, b)| self.focal_px * way(a, b))
    }
}
