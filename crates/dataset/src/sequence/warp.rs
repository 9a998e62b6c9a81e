//! Where frames show the same point of the material: through pinholes, or through a lens and a rolling shutter.

use ops::homography::Homography;
use ops::planes::{Mask, Planes};
use rayon::prelude::*;
use render::camera::Camera;
use render::lens::ImageLens;

use super::sensor::VideoSensor;
use crate::path::CameraPath;

/// Steps of the search for the row that reads a point. Each divides the error by the frame's height over the pixels that
/// the image moves while it is read: by ten or more for what a hand does.
const ROW_STEPS: usize = 40;
/// How well that row is known, in pixels.
const ROW_ERROR: f64 = 1e-7;

/// How the pixels of one frame lie on the material's plane: pinhole camera, lens, and the time at which each row is read.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct FrameGeometry {
    /// The cameras one frame before, at, and one frame after this one.
    around: [Camera; 3],
    pub lens: ImageLens,
    readout: f64,
    res: usize,
}

impl FrameGeometry {
    pub fn new(path: &CameraPath, frame: usize, sensor: &VideoSensor, res: usize) -> Self {
        let around = path.around(frame);
        // The cameras of a video have one field of view.
        let lens = ImageLens::new(sensor.distortion, &around[1], res);
        Self { around, lens, readout: sensor.readout, res }
    }

    /// Whether all rows are read at once.
    pub fn global_shutter(&self) -> bool {
        self.readout == 0.0
    }

    /// Whether a homography describes it all.
    pub fn is_pinhole(&self) -> bool {
        self.global_shutter() && self.lens.is_none()
    }

    /// The camera so many frames after the middle of this one, −1 to 1.
    pub fn camera(&self, delay: f64) -> Camera {
        let [before, at, after] = &self.around;
        if delay < 0.0 { at.towards(before, -delay) } else { at.towards(after, delay) }
    }

    /// When a row is read, in frames after the middle of this one. The first row comes first; the middle of the image is read
    /// at the middle of the frame.
    pub fn delay(&self, y: f64) -> f64 {
        let share = (y + 0.5) / self.res as f64;
        self.readout * (share.clamp(0.0, 1.0) - 0.5)
    }

    /// Delays of the renderings that the blurred frame is the mean of: one per pixel of the fastest motion while the shutter
    /// is open, at most `most`.
    pub fn exposure_delays(&self, shutter: f64, most: usize) -> Vec<f64> {
        let motion = Camera::between(&self.camera(-0.5 * shutter), &self.camera(0.5 * shutter), self.res);
        let (last, centre) = (self.res as f64 - 1.0, (self.res as f64 - 1.0) / 2.0);
        let fastest = [(0.0, 0.0), (last, 0.0), (0.0, last), (last, last), (centre, centre)]
            .into_iter()
            .filter_map(|(x, y)| motion.apply(x, y).map(|(u, v)| (u - x).hypot(v - y)))
            .fold(0.0, f64::max);
        let count = (fastest.ceil() as usize).min(most).max(1);
        (0..count).map(|k| ((k as f64 + 0.5) / count as f64 - 0.5) * shutter).collect()
    }

    /// The maps from pixels of the ideal image to the world while each row is read.
    fn rows_to_world(&self) -> Vec<Homography> {
        let rows = if self.global_shutter() { 1 } else { self.res };
        (0..rows).map(|y| self.camera(self.delay(y as f64)).pixel_to_world(self.res)).collect()
    }

    /// The maps from the world to the ideal image at the upper edge of every row and the lower one of the last.
    fn edges_to_pixel(&self) -> Vec<Homography> {
        let edges = if self.global_shutter() { 1 } else { self.res + 1 };
        (0..edges).map(|k| self.camera(self.delay(k as f64 - 0.5)).world_to_pixel(self.res)).collect()
    }
}

/// Maps a **target** pixel to the **source** pixel that shows the same point of the material.
#[derive(Clone, Debug, PartialEq)]
pub enum FrameWarp {
    /// Between pinhole cameras.
    Plane(Homography),
    /// Between frames of a lens that bends lines, or whose rows are read one after the other.
    Bent(Box<BentWarp>),
}

/// A [`FrameWarp`] that no homography describes.
#[derive(Clone, Debug, PartialEq)]
pub struct BentWarp {
    /// Target pixel to pixel of the frame `target`.
    to_target: Homography,
    target: FrameGeometry,
    /// [`FrameGeometry::rows_to_world`] of `target`.
    rows: Vec<Homography>,
    source: FrameGeometry,
    /// [`FrameGeometry::edges_to_pixel`] of `source`.
    edges: Vec<Homography>,
    /// Pixel of the frame `source` to source pixel.
    from_source: Homography,
}

impl BentWarp {
    /// The world point that the frame `target` shows at a pixel.
    fn to_world(&self, x: f64, y: f64) -> Option<(f64, f64)> {
        let (u, v) = self.target.lens.undistort((x, y));
        if self.target.global_shutter() {
            return self.rows[0].apply(u, v);
        }
        // Pixels lie in rows; only a map between other images asks for what is between them.
        let nearest = y.round() as usize;
        match self.rows.get(nearest) {
            Some(row) if (y - nearest as f64).abs() < 1e-9 => row.apply(u, v),
            _ => self.target.camera(self.target.delay(y)).pixel_to_world(self.target.res).apply(u, v),
        }
    }

    /// The pixel of the frame `source` that shows a world point: that whose row is read while the camera sees the point in that
    /// row.
    fn to_pixel(&self, x: f64, y: f64) -> Option<(f64, f64)> {
        if self.source.global_shutter() {
            return self.edges[0].apply(x, y).map(|ideal| self.source.lens.distort(ideal));
        }
        let mut row = (self.source.res as f64 - 1.0) / 2.0;
        for _ in 0..ROW_STEPS {
            let seen = self.source.lens.distort(self.at_row(row).apply(x, y)?);
            if (seen.1 - row).abs() < ROW_ERROR {
                return Some(seen);
            }
            row = seen.1;
        }
        None
    }

    /// The map from the world to the ideal image while a row of `source` is read, rows before and after the image with the
    /// first and last edge. Between two edges the camera moves by a hundredth of what it moves from frame to frame or
    /// less, so that a straight line stands for its way within 1e-6 pixels.
    fn at_row(&self, row: f64) -> Homography {
        let place = (row + 0.5).clamp(0.0, self.source.res as f64);
        let edge = (place as usize).min(self.source.res - 1);
        let (above, below) = (&self.edges[edge].matrix, &self.edges[edge + 1].matrix);
        Homography { matrix: above + (below - above) * (place - edge as f64) }
    }
}

impl FrameWarp {
    pub(super) fn bent(target: FrameGeometry, source: FrameGeometry) -> Self {
        let (to_target, from_source) = (Homography::identity(), Homography::identity());
        let (rows, edges) = (target.rows_to_world(), source.edges_to_pixel());
        Self::Bent(Box::new(BentWarp { to_target, target, rows, source, edges, from_source }))
    }

    /// The same map between parts or mirror images of the frames: `to_target` leads from a pixel of the new target to the
    /// present one's, `from_source` from the present source's to the new one's.
    pub fn within(self, to_target: &Homography, from_source: &Homography) -> Self {
        match self {
            Self::Plane(map) => Self::Plane(from_source.after(&map).after(to_target)),
            Self::Bent(mut warp) => {
                warp.to_target = warp.to_target.after(to_target);
                warp.from_source = from_source.after(&warp.from_source);
                Self::Bent(warp)
            }
        }
    }

    /// The source position of target position (x, y); `None` where there is none.
    pub fn apply(&self, x: f64, y: f64) -> Option<(f64, f64)> {
        match self {
            Self::Plane(map) => map.apply(x, y),
            Self::Bent(warp) => {
                let (x, y) = warp.to_target.apply(x, y)?;
                let (x, y) = warp.to_world(x, y)?;
                let (x, y) = warp.to_pixel(x, y)?;
                warp.from_source.apply(x, y)
            }
        }
    }

    /// The dense backward flow of a target of [height, width] pixels, and the pixels whose point is inside a source of such a
    /// size.
    ///
    /// # Shapes
    /// 2 planes (x, y) in pixels, NaN where there is no source position, and a mask.
    pub fn flow(&self, target: [usize; 2], source: [usize; 2]) -> (Planes, Mask) {
        match self {
            Self::Plane(map) => labels(|x, y| map.apply(x, y), target, source),
            Self::Bent(_) => labels(|x, y| self.apply(x, y), target, source),
        }
    }
}

/// The flow of a map and the pixels that it leads to a place inside the source, row by row.
fn labels(
    map: impl Fn(f64, f64) -> Option<(f64, f64)> + Sync,
    [height, width]: [usize; 2],
    [source_height, source_width]: [usize; 2],
) -> (Planes, Mask) {
    let (right, bottom) = ((source_width - 1) as f64, (source_height - 1) as f64);
    let mut flow = Planes::new(2, height, width);
    let mut valid = Mask { height, width, data: vec![false; height * width] };
    let (across, down) = flow.data.split_at_mut(height * width);
    let rows = across.par_chunks_mut(width).zip(down.par_chunks_mut(width)).zip(valid.data.par_chunks_mut(width));
    rows.enumerate().for_each(|(row, ((across, down), valid))| {
        let y = row as f64;
        for column in 0..width {
            let x = column as f64;
            let (u, v) = map(x, y).unwrap_or((f64::NAN, f64::NAN));
            (across[column], down[column]) = ((u - x) as f32, (v - y) as f32);
            valid[column] = u >= 0.0 && v >= 0.0 && u <= right && v <= bottom;
        }
    });
    (flow, valid)
}
