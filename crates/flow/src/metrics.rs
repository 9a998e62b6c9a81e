//! End-point error (EPE): how far a flow's points lie from where they should.

use ops::planes::{Mask, Planes};
use serde::Serialize;

/// Statistics of the end-point errors of all valid pixels.
///
/// # Units
/// Pixels; shares between 0 and 1.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct EndPointError {
    /// Mean error.
    pub mean_px: f64,
    /// Error that half of the pixels exceed.
    pub median_px: f64,
    /// Error that 5 % of the pixels exceed.
    pub p95_px: f64,
    /// Share of pixels with an error above 1 px.
    pub over_1_px: f64,
    /// Share of pixels with an error above 3 px.
    pub over_3_px: f64,
    /// Share of pixels with an error above 5 px.
    pub over_5_px: f64,
    /// Mean error of a flow of zero: how far the points move.
    pub zero_flow_px: f64,
    /// `mean_px / zero_flow_px`: 1 says that nothing was learnt.
    pub ratio: f64,
    /// Number of valid pixels.
    pub pixels: usize,
}

/// Gathers errors over many pairs.
#[derive(Clone, Debug, Default)]
pub struct EndPointErrors {
    errors: Vec<f32>,
    zero_flow_sum: f64,
}

impl EndPointErrors {
    /// Adds the valid pixels of one pair. A flow that is no number counts as an infinite error.
    ///
    /// # Shapes
    /// `flow, target`: two channels (x, y) in pixels; all of one size.
    ///
    /// # Panics
    /// If the sizes differ.
    pub fn add(&mut self, flow: &Planes, target: &Planes, valid: &Mask) {
        let size = |p: &Planes| (p.channels, p.height, p.width);
        assert_eq!(size(flow), (2, valid.height, valid.width), "flow and mask differ in size");
        assert_eq!(size(flow), size(target), "flow and target differ in size");
        for (i, _) in valid.data.iter().enumerate().filter(|(_, valid)| **valid) {
            let (tx, ty) = (target.plane(0)[i], target.plane(1)[i]);
            let error = (flow.plane(0)[i] - tx).hypot(flow.plane(1)[i] - ty);
            self.errors.push(if error.is_nan() { f32::INFINITY } else { error });
            self.zero_flow_sum += f64::from(tx.hypot(ty));
        }
    }

    /// The statistics, or `None` if there was no valid pixel.
    pub fn finish(mut self) -> Option<EndPointError> {
        if self.errors.is_empty() {
            return None;
        }
        self.errors.sort_unstable_by(f32::total_cmp);
        let pixels = self.errors.len();
        let quantile = |q: f64| f64::from(self.errors[((pixels - 1) as f64 * q).round() as usize]);
        let over = |limit: f32| (pixels - self.errors.partition_point(|&e| e <= limit)) as f64 / pixels as f64;
        let mean_px = self.errors.iter().map(|&e| f64::from(e)).sum::<f64>() / pixels as f64;
        let zero_flow_px = self.zero_flow_sum / pixels as f64;
        Some(EndPointError {
            mean_px,
            median_px: quantile(0.5),
            p95_px: quantile(0.95),
            over_1_px: over(1.0),
            over_3_px: over(3.0),
            over_5_px: over(5.0),
            zero_flow_px,
            ratio: mean_px / zero_flow_px.max(1e-9),
            pixels,
        })
    }
}

/// The end-point error of one pair; `None` if no pixel is valid.
///
/// # Shapes
/// As [`EndPointErrors::add`].
pub fn end_point_error(flow: &Planes, target: &Planes, valid: &Mask) -> Option<EndPointError> {
    let mut errors = EndPointErrors::default();
    errors.add(flow, target, valid);
    errors.finish()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn statistics_by_hand() {
        let target = Planes::constant(1, 5, &[3.0, 4.0]);
        let mut flow = target.clone();
        for (x, error) in [0.0, 0.5, 2.0, 4.0, 99.0].into_iter().enumerate() {
            flow.set(0, 0, x, 3.0 + error);
        }
        let mut valid = Mask::new(1, 5, true);
        valid.data[4] = false;
        let epe = end_point_error(&flow, &target, &valid).unwrap();
        assert_eq!(epe.pixels, 4);
        assert!((epe.mean_px - 1.625).abs() < 1e-6);
        assert_eq!((epe.over_1_px, epe.over_3_px, epe.over_5_px), (0.5, 0.25, 0.0));
        assert_eq!((epe.median_px, epe.p95_px, epe.zero_flow_px), (2.0, 4.0, 5.0));
        assert!((epe.ratio - 0.325).abs() < 1e-6);
    }

    #[test]
    fn no_valid_pixel_gives_nothing_and_a_broken_flow_is_infinitely_wrong() {
        let target = Planes::constant(2, 2, &[1.0, 0.0]);
        assert_eq!(end_point_error(&target, &target, &Mask::new(2, 2, false)), None);
        let mut flow = target.clone();
        flow.set(0, 1, 1, f32::NAN);
        let epe = end_point_error(&flow, &target, &Mask::new(2, 2, true)).unwrap();
        assert!(epe.mean_px.is_infinite() && epe.p95_px.is_infinite() && epe.over_5_px == 0.25);
        assert_eq!(epe.median_px, 0.0);
    }

    #[test]
    fn zero_flow_has_ratio_one_and_pairs_are_weighed_by_pixels() {
        let (near, far) = (Planes::constant(4, 4, &[0.0, 2.0]), Planes::constant(1, 4, &[6.0, 8.0]));
        let mut errors = EndPointErrors::default();
        errors.add(&Planes::new(2, 4, 4), &near, &Mask::new(4, 4, true));
        errors.add(&Planes::new(2, 1, 4), &far, &Mask::new(1, 4, true));
        let epe = errors.finish().unwrap();
        assert!((epe.ratio - 1.0).abs() < 1e-9);
        assert!((epe.mean_px - (16.0 * 2.0 + 4.0 * 10.0) / 20.0).abs() < 1e-6);
    }
}
