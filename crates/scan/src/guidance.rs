//! A guidance photo of its own (paper §7): frame 0 is located in it, and what the scan shows is given in the photo's axes.
//!
//! Frames are aligned to frame 0 and the maps are made in its axes, as without a photo, because the nets don't know turned
//! frames. Then everything moves to a square of the photo, at the video's density, that frame 0 shows whole. The rest of the
//! photo stays empty: larger maps than a frame aren't made yet.

use flow::align::PhotometricConfig;
use flow::align::localise::{LocaliseConfig, Located, NotLocated, localise, localise_near};
use flow::align::size::Size;
use nalgebra::Matrix3;
use ops::flow_field::warp_planes;
use ops::homography::Homography;
use ops::planes::Planes;
use render::svbrdf::SvbrdfImage;

use crate::reconstruct::Reconstruction;

/// A photo and, where the person says so, what part of it frame 0 shows.
#[derive(Clone, Debug)]
pub struct GuidancePhoto {
    /// 3 gamma-encoded planes.
    pub photo: Planes,
    /// Row and column range `[y0, y1, x0, x1]` in pixels of the photo.
    pub start: Option<[f64; 4]>,
}

/// The square of the photo that the maps show.
#[derive(Clone, Debug)]
pub struct View {
    /// Where frame 0 was found.
    pub located: Located,
    /// Pixel of the maps to pixel of the photo.
    pub to_photo: Homography,
    /// Pixel of the maps to pixel of frame 0.
    pub to_frame: Homography,
    /// Rows and columns of the maps.
    pub side: usize,
    /// The photo there, at the maps' density.
    pub picture: Planes,
}

impl GuidancePhoto {
    /// Looks for frame 0 in the photo.
    ///
    /// # Errors
    /// [`NotLocated`].
    pub fn view(&self, frame: &Planes, config: &LocaliseConfig, photometric: &PhotometricConfig) -> Result<View, NotLocated> {
        let located = match self.start {
            Some(start) => localise_near(&self.photo, frame, start, photometric)?,
            None => localise(&self.photo, frame, config, photometric)?,
        };
        let missing = NotLocated::NotFound { zncc: located.zncc, significance: located.significance };
        View::new(&self.photo, Size::of(frame), located).ok_or(missing)
    }
}

impl View {
    /// The largest square in the photo's axes, at the frame's density, that the frame shows whole; `None` where there is none.
    fn new(photo: &Planes, frame: Size, located: Located) -> Option<Self> {
        let (cx, cy) = (0.5 * (frame.width as f64 - 1.0), 0.5 * (frame.height as f64 - 1.0));
        let middle = located.homography.inverse()?.apply(cx, cy)?;
        let at = |side: usize| {
            let (step, half) = (1.0 / located.scale, 0.5 * (side as f64 - 1.0) / located.scale);
            let matrix = Matrix3::new(step, 0.0, middle.0 - half, 0.0, step, middle.1 - half, 0.0, 0.0, 1.0);
            let to_photo = Homography { matrix };
            (to_photo, located.homography.after(&to_photo))
        };
        let shown = |side: usize| {
            let (to_photo, to_frame) = at(side);
            let last = side as f64 - 1.0;
            [(0.0, 0.0), (last, 0.0), (last, last), (0.0, last)].iter().all(|&(x, y)| {
                // Half a hundredth of a pixel for the warp's rounding.
                let inside = |h: &Homography, size: Size| {
                    let off = [(-0.005, -0.005), (0.005, 0.005)];
                    h.apply(x, y).is_some_and(|p| off.iter().all(|o| size.contains((p.0 + o.0, p.1 + o.1))))
                };
                inside(&to_frame, frame) && inside(&to_photo, Size::of(photo))
            })
        };
        let side = (16..=frame.width.min(frame.height)).rev().find(|&side| shown(side))?;
        let (to_photo, to_frame) = at(side);
        let (picture, _) = warp_planes(photo, &to_photo.flow(side, side));
        Some(Self { located, to_photo, to_frame, side, picture })
    }

    /// The result as this square shows it. The camera keeps the axes of frame 0.
    pub fn of(self, result: Reconstruction) -> Reconstruction {
        let (side, flow) = (self.side, self.to_frame.flow(self.side, self.side));
        let moved = |planes: &Planes| warp_planes(planes, &flow).0;
        let maps = SvbrdfImage {
            normal: turned(moved(&result.maps.normal), &self.to_frame, side),
            diffuse: moved(&result.maps.diffuse),
            roughness: moved(&result.maps.roughness),
            specular: moved(&result.maps.specular),
        };
        let coverage = moved(&result.coverage);
        let alignment = result.alignment.in_view(&self.to_frame, Size { height: side, width: side });
        Reconstruction { alignment, maps, coverage, view: Some(self), ..result }
    }
}

/// Normals in the axes of the view instead of the frame's: turned back by the map's rotation (y points up in normals).
fn turned(mut normal: Planes, to_frame: &Homography, side: usize) -> Planes {
    let middle = 0.5 * (side as f64 - 1.0);
    let at = |x: f64, y: f64| to_frame.apply(x, y).unwrap_or((x, y));
    let (a, b) = (at(middle - 1.0, middle), at(middle + 1.0, middle));
    let (dx, dy) = (b.0 - a.0, b.1 - a.1);
    let (cos, sin) = ((dx / dx.hypot(dy)) as f32, (dy / dx.hypot(dy)) as f32);
    let area = normal.area();
    for i in 0..area {
        let (x, up, z) = (normal.data[i], normal.data[area + i], normal.data[2 * area + i]);
        let (x, up) = (cos * x - sin * up, sin * x + cos * up);
        let length = (x * x + up * up + z * z).sqrt().max(1e-6);
        (normal.data[i], normal.data[area + i], normal.data[2 * area + i]) = (x / length, up / length, z / length);
    }
    normal
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reconstruct::ReconstructError;

    fn located(homography: Homography, scale: f64) -> Located {
        Located { homography, scale, zncc: 0.8, significance: 40.0, runner_up: 0.1, expected_px: 0.2 }
    }

    #[test]
    fn the_view_lies_in_frame_and_photo_at_the_frames_density() {
        let photo = Planes::constant(100, 120, &[0.5; 3]);
        let frame = Size { height: 80, width: 80 };
        // The frame shows photo columns 50 to 90, rows 20 to 60: two pixels per pixel.
        let at = Homography { matrix: Matrix3::new(2.0, 0.0, -99.5, 0.0, 2.0, -39.5, 0.0, 0.0, 1.0) };
        let view = View::new(&photo, frame, located(at, 2.0)).unwrap();
        assert_eq!(view.side, 79);
        let (x, y) = view.to_frame.apply(0.0, 0.0).unwrap();
        assert!((x - 0.5).abs() < 1e-9 && (y - 0.5).abs() < 1e-9);
        let (a, b) = (view.to_photo.apply(0.0, 5.0).unwrap(), view.to_photo.apply(10.0, 5.0).unwrap());
        assert!((b.0 - a.0 - 5.0).abs() < 1e-9 && (b.1 - a.1).abs() < 1e-9);
        // Turned by 45° only a smaller square is whole.
        let turn = nalgebra::Rotation2::new(std::f64::consts::FRAC_PI_4).to_homogeneous();
        let centred = Homography::translation(39.5, 39.5).matrix * turn * Homography::translation(-39.5, -39.5).matrix;
        let view = View::new(&photo, frame, located(Homography::new(centred * at.matrix), 2.0)).unwrap();
        assert!((54..=57).contains(&view.side), "{}", view.side);
        // At the photo's edge it ends there.
        let low = Homography { matrix: Matrix3::new(2.0, 0.0, -199.5, 0.0, 2.0, -39.5, 0.0, 0.0, 1.0) };
        assert!(View::new(&photo, frame, located(low, 2.0)).is_none_or(|v| v.side < 80));
    }

    #[test]
    fn a_refusal_gives_its_reason_once_and_says_what_to_do() {
        let refused = anyhow::Error::from(ReconstructError::Guidance(NotLocated::Ambiguous { runner_up: 0.9 }));
        let text = format!("{refused:#}");
        assert_eq!(text.matches("the pattern repeats").count(), 1, "{text}");
        assert!(text.contains("--start"), "{text}");
    }

    #[test]
    fn normals_turn_with_the_axes() {
        // Frame pixel (x, y) of view pixel (u, v): a quarter turn, x = −v, y = u.
        let quarter = Homography { matrix: Matrix3::new(0.0, -1.0, 9.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0) };
        // Leaning to the frame's right: in the view that is up, as v falls where x grows.
        let normal = turned(Planes::constant(10, 10, &[0.6, 0.0, 0.8]), &quarter, 10);
        let close = |c: usize, expected: f32| (normal.at(c, 4, 4) - expected).abs() < 1e-5;
        assert!(close(0, 0.0) && close(1, 0.6) && close(2, 0.8), "{} {}", normal.at(0, 4, 4), normal.at(1, 4, 4));
    }
}
