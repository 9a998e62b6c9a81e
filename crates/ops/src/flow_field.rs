//! Dense flow on the CPU: warping images and composing flows, with masks.

use rayon::prelude::*;

use crate::planes::{Mask, Planes, Taps};

/// Samples `source` at `target pixel + flow`.
///
/// # Shapes
/// `flow` has 2 planes of the target's size; the result has the source's channels at the target's size and a mask of the
/// pixels whose taps all lie inside the source. Invalid pixels are 0.
pub fn warp_planes(source: &Planes, flow: &Planes) -> (Planes, Mask) {
    let (height, width) = (flow.height, flow.width);
    let taps: Vec<Option<Taps>> = (0..height * width)
        .into_par_iter()
        .with_min_len(1 << 12)
        .map(|i| {
            let (x, y) = ((i % width) as f32 + flow.data[i], (i / width) as f32 + flow.data[height * width + i]);
            Taps::inside(x, y, source.height, source.width)
        })
        .collect();
    let mut out = Planes::new(source.channels, height, width);
    out.data.par_chunks_mut(height * width).enumerate().for_each(|(c, plane)| {
        let from = source.plane(c);
        plane.iter_mut().zip(&taps).for_each(|(v, t)| *v = t.map_or(0.0, |t| t.apply(from)));
    });
    (out, Mask { height, width, data: taps.iter().map(Option::is_some).collect() })
}

/// The flow that follows `first` and then `second`: target → middle → source.
///
/// `first` leads from the target into the image where `second` is defined. A point that leaves the middle image, or lands
/// on a pixel of it that is invalid, becomes invalid (paper §5, warp composition).
pub fn compose(first: &Planes, first_valid: &Mask, second: &Planes, second_valid: &Mask) -> (Planes, Mask) {
    let (stepped, inside) = warp_planes(second, first);
    let (reached, _) = warp_planes(&second_valid.to_planes(), first);
    let mut flow = stepped;
    flow.data.iter_mut().zip(&first.data).for_each(|(s, f)| *s += f);
    let data =
        (0..first_valid.data.len()).map(|i| first_valid.data[i] && inside.data[i] && reached.data[i] > 1.0 - 1e-4).collect();
    (flow, Mask { data, ..*first_valid })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::homography::Homography;

    #[test]
    fn warping_by_a_shift_moves_pixels_and_marks_the_border() {
        let source = Planes::from_vec(1, 1, 4, vec![1.0, 2.0, 3.0, 4.0]);
        let (out, valid) = warp_planes(&source, &Homography::translation(1.5, 0.0).flow(1, 4));
        assert_eq!(out.data, vec![2.5, 3.5, 0.0, 0.0]);
        assert_eq!(valid.data, vec![true, true, false, false]);
    }

    #[test]
    fn composing_flows_of_two_homographies_is_the_flow_of_their_product() {
        let a = Homography::translation(3.25, -1.5);
        let b = Homography::new(nalgebra::Matrix3::new(1.02, 0.01, 2.0, -0.01, 0.99, 1.0, 0.0, 0.0, 1.0));
        let (h, w) = (24, 32);
        let valid = |m: &Homography| m.valid(h, w, h, w);
        let (flow, mask) = compose(&a.flow(h, w), &valid(&a), &b.flow(h, w), &valid(&b));
        let exact = b.after(&a).flow(h, w);
        assert!(mask.count() > 400);
        for i in (0..h * w).filter(|&i| mask.data[i]) {
            assert!((flow.data[i] - exact.data[i]).abs() < 1e-4);
            assert!((flow.data[h * w + i] - exact.data[h * w + i]).abs() < 1e-4);
        }
    }
}
