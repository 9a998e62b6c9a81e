//! How well key frames are aligned, against exact homographies (spec 6.1). All distances are in pixels at a width of 1024.

use ops::homography::Homography;
use serde::Serialize;

use super::result::{Alignment, KeyFrame};
use super::size::Size;

/// Width at which distances are stated.
pub const REFERENCE_WIDTH: f64 = 1024.0;
/// What a reference pixel without a prediction costs in the penalised error, and the largest distance that counts there.
pub const PENALTY_PX: f64 = 20.0;
/// Positions per side at which warps are compared.
const SIDE: usize = 64;
/// A scan has diverged when its mean error exceeds this …
const DIVERGED_PX: f64 = 10.0;
/// … or less than this share of the reference pixels is valid.
const DIVERGED_VALID: f64 = 0.5;

/// The figures of one or more scans.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct AlignmentMetrics {
    /// Reference pixels that the aligned key frames cover, as a share of all reference pixels.
    pub valid_rate: f64,
    /// Mean distance over pixels that are valid in both.
    pub pixel_error: f64,
    /// Median of the same.
    pub pixel_error_median: f64,
    /// 95th percentile of the same.
    pub pixel_error_p95: f64,
    /// Mean over all reference pixels of the distance, capped at 20; a missing pixel counts 20.
    pub penalised_error: f64,
    /// Share of key frames whose *median* distance over the reference pixels is at most 20; a dropped key frame isn't.
    pub within_20px: f64,
    /// The same for 4 pixels.
    pub within_4px: f64,
    /// Share of scans that diverged (mean error above 10, or less than half valid).
    pub diverged: f64,
    /// Key frames with reference pixels.
    pub key_frames: usize,
}

/// The exact position of a guidance pixel in a key frame.
type Exact<'a> = &'a dyn Fn(f64, f64) -> Option<(f64, f64)>;

/// The distances of one key frame.
#[derive(Clone, Debug, Default)]
struct FrameErrors {
    /// Which of the key frames.
    key_frame: usize,
    /// Over pixels valid in both.
    distances: Vec<f64>,
    /// Reference pixels.
    reference: usize,
    /// Median distance of the prediction over the reference pixels, valid or not; infinite for a dropped frame.
    median: f64,
}

/// The distances of one scan.
#[derive(Clone, Debug, Default)]
pub struct ScanErrors {
    frames: Vec<FrameErrors>,
}

impl ScanErrors {
    /// Compares an alignment with the exact homographies (guidance pixel to frame pixel at full size, one per key frame, in
    /// the alignment's order). Key frames that show nothing of the guidance image don't count.
    ///
    /// # Panics
    /// If there isn't one homography per key frame.
    pub fn new(alignment: &Alignment, exact: &[Homography], guidance: Size) -> Self {
        assert_eq!(alignment.key_frames.len(), exact.len(), "one exact homography per key frame");
        let frames = alignment.key_frames.iter().zip(exact);
        Self::of_frames(frames.map(|(k, e)| k.errors(&|x, y| e.apply(x, y), guidance)))
    }

    /// As [`ScanErrors::new`] against exact warps that needn't be homographies (a lens that bends lines, a rolling shutter):
    /// `exact(frame, x, y)` is the position in frame `frame` of guidance pixel (x, y).
    pub fn of_warps(alignment: &Alignment, exact: impl Fn(usize, f64, f64) -> Option<(f64, f64)>, guidance: Size) -> Self {
        Self::of_frames(alignment.key_frames.iter().map(|k| k.errors(&|x, y| exact(k.index, x, y), guidance)))
    }

    fn of_frames(frames: impl Iterator<Item = FrameErrors>) -> Self {
        let numbered = frames.enumerate().map(|(key_frame, errors)| FrameErrors { key_frame, ..errors });
        Self { frames: numbered.filter(|f| f.reference > 0).collect() }
    }

    /// Number (in the alignment's order) and mean distance of every key frame that shares reference pixels with its
    /// prediction: dropped ones don't.
    pub fn means(&self) -> impl Iterator<Item = (usize, f64)> + '_ {
        let shared = self.frames.iter().filter(|f| !f.distances.is_empty());
        shared.map(|f| (f.key_frame, f.distances.iter().sum::<f64>() / f.distances.len() as f64))
    }

    /// Compares homographies (`None` for a dropped frame) with exact ones, for baselines such as identity.
    pub fn of_homographies(predicted: &[Option<Homography>], exact: &[Homography], guidance: Size, frame: Size) -> Self {
        let compare = |(p, e): (&Option<Homography>, &Homography)| {
            compare(&|x, y| e.apply(x, y), guidance, frame, |x, y| {
                p.and_then(|h| h.apply(x, y)).map(|q| (q, frame.contains(q)))
            })
        };
        Self::of_frames(predicted.iter().zip(exact).map(compare))
    }

    fn mean(&self) -> f64 {
        let all: Vec<f64> = self.frames.iter().flat_map(|f| f.distances.iter().copied()).collect();
        all.iter().sum::<f64>() / all.len().max(1) as f64
    }

    fn valid_rate(&self) -> f64 {
        let valid: usize = self.frames.iter().map(|f| f.distances.len()).sum();
        valid as f64 / self.frames.iter().map(|f| f.reference).sum::<usize>().max(1) as f64
    }

    fn diverged(&self) -> bool {
        self.mean() > DIVERGED_PX || self.valid_rate() < DIVERGED_VALID
    }
}

impl KeyFrame {
    fn errors(&self, exact: Exact, guidance: Size) -> FrameErrors {
        let warp = self.dense.as_ref().filter(|_| self.aligned()).map(|_| self.warp(guidance.height, guidance.width));
        compare(exact, guidance, self.frame_size, |x, y| {
            if !self.aligned() {
                return None;
            }
            let Some((flow, valid)) = &warp else {
                return self.homography.apply(x, y).map(|q| (q, self.frame_size.contains(q)));
            };
            let q = (
                x + f64::from(flow.sample_bilinear(0, x as f32, y as f32)?),
                y + f64::from(flow.sample_bilinear(1, x as f32, y as f32)?),
            );
            Some((q, valid.at(y.round() as usize, x.round() as usize)))
        })
    }
}

/// `predict` gives the predicted source position and whether the warp calls it valid.
fn compare(exact: Exact, guidance: Size, frame: Size, predict: impl Fn(f64, f64) -> Option<((f64, f64), bool)>) -> FrameErrors {
    let scale = REFERENCE_WIDTH / frame.width as f64;
    let mut errors = FrameErrors { median: f64::INFINITY, ..FrameErrors::default() };
    let mut all = Vec::new();
    for (x, y) in guidance.grid(SIDE.min(guidance.width).min(guidance.height)) {
        let Some(truth) = exact(x, y).filter(|&p| frame.contains(p)) else { continue };
        errors.reference += 1;
        let Some((q, valid)) = predict(x, y) else {
            all.push(f64::INFINITY);
            continue;
        };
        let distance = scale * (q.0 - truth.0).hypot(q.1 - truth.1);
        all.push(if distance.is_nan() { f64::INFINITY } else { distance });
        if valid && distance.is_finite() {
            errors.distances.push(distance);
        }
    }
    all.sort_by(f64::total_cmp);
    if let Some(&median) = all.get(all.len() / 2) {
        errors.median = median;
    }
    errors
}

/// The figures over all pixels of several scans.
pub fn summarise(scans: &[ScanErrors]) -> AlignmentMetrics {
    let frames: Vec<&FrameErrors> = scans.iter().flat_map(|s| &s.frames).collect();
    let mut distances: Vec<f64> = frames.iter().flat_map(|f| f.distances.iter().copied()).collect();
    let reference: usize = frames.iter().map(|f| f.reference).sum();
    if reference == 0 {
        return AlignmentMetrics::default();
    }
    distances.sort_by(f64::total_cmp);
    let quantile = |q: f64| distances.get(((distances.len() as f64 * q) as usize).min(distances.len().saturating_sub(1)));
    let missing = (reference - distances.len()) as f64;
    let capped: f64 = distances.iter().map(|d| d.min(PENALTY_PX)).sum();
    let within = |limit: f64| frames.iter().filter(|f| f.median <= limit).count() as f64 / frames.len() as f64;
    AlignmentMetrics {
        valid_rate: distances.len() as f64 / reference as f64,
        pixel_error: distances.iter().sum::<f64>() / distances.len().max(1) as f64,
        pixel_error_median: quantile(0.5).copied().unwrap_or(f64::INFINITY),
        pixel_error_p95: quantile(0.95).copied().unwrap_or(f64::INFINITY),
        penalised_error: (capped + PENALTY_PX * missing) / reference as f64,
        within_20px: within(20.0),
        within_4px: within(4.0),
        diverged: scans.iter().filter(|s| s.diverged()).count() as f64 / scans.len() as f64,
        key_frames: frames.len(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: Size = Size { height: 256, width: 256 };

    fn of(predicted: Option<Homography>, exact: Homography) -> AlignmentMetrics {
        summarise(&[ScanErrors::of_homographies(&[predicted], &[exact], SIZE, SIZE)])
    }

    #[test]
    fn exact_warps_have_no_error_and_a_shift_counts_at_1024_scale() {
        let exact = Homography::translation(64.0, 0.0);
        let m = of(Some(exact), exact);
        assert_eq!((m.valid_rate, m.pixel_error, m.penalised_error, m.within_20px, m.diverged), (1.0, 0.0, 0.0, 1.0, 0.0));
        // 3 px at 256 are 12 px at 1024. Of 48 columns of grid points that are in the reference, the last may leave.
        let m = of(Some(Homography::translation(67.0, 0.0)), exact);
        assert!((m.pixel_error - 12.0).abs() < 1e-9 && (m.pixel_error_p95 - 12.0).abs() < 1e-9);
        let rate = 47.0 / 48.0;
        assert!((m.valid_rate - rate).abs() < 1e-9, "{}", m.valid_rate);
        assert!((m.penalised_error - (12.0 * rate + 20.0 / 48.0)).abs() < 1e-9);
        assert_eq!((m.within_20px, m.within_4px, m.diverged), (1.0, 0.0, 1.0));
    }

    #[test]
    fn a_dropped_frame_costs_the_penalty_and_a_frame_without_overlap_nothing() {
        let m = of(None, Homography::identity());
        assert_eq!((m.valid_rate, m.penalised_error, m.within_20px, m.diverged), (0.0, 20.0, 0.0, 1.0));
        let away = Homography::translation(1000.0, 0.0);
        let scan =
            ScanErrors::of_homographies(&[None, Some(Homography::identity())], &[away, Homography::identity()], SIZE, SIZE);
        let m = summarise(&[scan]);
        assert_eq!((m.key_frames, m.valid_rate, m.within_20px), (1, 1.0, 1.0));
        assert_eq!(summarise(&[]), AlignmentMetrics::default());
    }
}
