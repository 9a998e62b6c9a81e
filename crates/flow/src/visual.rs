//! Pictures of flow: direction as hue, length as saturation.

use ops::planes::{Mask, Planes};

/// Colours per transition of the wheel: red to yellow, yellow to green, green to cyan, cyan to blue, blue to magenta,
/// magenta to red. Unequal, so that neighbouring directions are told apart equally well.
///
/// # Source
/// Baker et al., A Database and Evaluation Methodology for Optical Flow (the Middlebury colour code).
const TRANSITIONS: [(usize, [f32; 3], [f32; 3]); 6] = [
    (15, [1.0, 0.0, 0.0], [1.0, 1.0, 0.0]),
    (6, [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]),
    (4, [0.0, 1.0, 0.0], [0.0, 1.0, 1.0]),
    (11, [0.0, 1.0, 1.0], [0.0, 0.0, 1.0]),
    (13, [0.0, 0.0, 1.0], [1.0, 0.0, 1.0]),
    (6, [1.0, 0.0, 1.0], [1.0, 0.0, 0.0]),
];
/// Unknown flow.
const UNKNOWN: [f32; 3] = [0.25, 0.25, 0.25];
/// How much flow beyond the full length darkens.
const BEYOND: f32 = 0.75;

/// The colour of one flow vector whose full saturation is at `full_px`.
///
/// # Units
/// Encoded RGB in \[0, 1\]; white is no flow.
pub fn colour(x_px: f32, y_px: f32, full_px: f32) -> [f32; 3] {
    if !(x_px.is_finite() && y_px.is_finite()) {
        return UNKNOWN;
    }
    let length = x_px.hypot(y_px) / full_px.max(1e-6);
    let turn = (-y_px).atan2(-x_px) / std::f32::consts::TAU + 0.5;
    wheel(turn).map(|hue| if length <= 1.0 { 1.0 - length * (1.0 - hue) } else { hue * BEYOND })
}

/// The hue at a share of the full turn, clockwise in the image from +x.
fn wheel(turn: f32) -> [f32; 3] {
    let colours: usize = TRANSITIONS.iter().map(|t| t.0).sum();
    let mut position = turn.rem_euclid(1.0) * colours as f32;
    for (steps, from, to) in TRANSITIONS {
        if position < steps as f32 {
            let share = position / steps as f32;
            return std::array::from_fn(|c| from[c] + share * (to[c] - from[c]));
        }
        position -= steps as f32;
    }
    TRANSITIONS[0].1
}

/// A picture of a flow; unknown pixels are dark grey.
///
/// # Shapes
/// `flow`: two channels (x, y) in pixels → three channels of the same size.
///
/// # Panics
/// If the mask has another size.
pub fn picture(flow: &Planes, valid: Option<&Mask>, full_px: f32) -> Planes {
    assert_eq!(flow.channels, 2, "a flow has two channels");
    if let Some(mask) = valid {
        assert_eq!((mask.height, mask.width), (flow.height, flow.width), "flow and mask differ in size");
    }
    let mut out = Planes::new(3, flow.height, flow.width);
    for i in 0..flow.area() {
        let known = valid.is_none_or(|mask| mask.data[i]);
        let rgb = if known { colour(flow.plane(0)[i], flow.plane(1)[i], full_px) } else { UNKNOWN };
        for (c, value) in rgb.into_iter().enumerate() {
            out.plane_mut(c)[i] = value;
        }
    }
    out
}

/// The length that 95 % of the known pixels don't exceed: a good `full_px` for [`picture`]. At least 1e-3.
pub fn full_length_px(flow: &Planes, valid: Option<&Mask>) -> f32 {
    let mut lengths: Vec<f32> = (0..flow.area())
        .filter(|&i| valid.is_none_or(|mask| mask.data[i]))
        .map(|i| flow.plane(0)[i].hypot(flow.plane(1)[i]))
        .filter(|length| length.is_finite())
        .collect();
    lengths.sort_unstable_by(f32::total_cmp);
    let last = lengths.len().saturating_sub(1);
    lengths.get((last as f32 * 0.95) as usize).copied().unwrap_or(0.0).max(1e-3)
}

/// The legend of [`picture`]: a disc whose rim is flow of the full length, white outside.
pub fn legend(side: usize) -> Planes {
    let centre = (side as f32 - 1.0) / 2.0;
    let mut out = Planes::constant(side, side, &[1.0; 3]);
    for y in 0..side {
        for x in 0..side {
            let (dx, dy) = (x as f32 - centre, y as f32 - centre);
            if dx.hypot(dy) <= centre {
                let rgb = colour(dx, dy, centre);
                (0..3).for_each(|c| out.set(c, y, x, rgb[c]));
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_flow_is_white_and_right_is_red() {
        assert_eq!(colour(0.0, 0.0, 5.0), [1.0; 3]);
        let red = colour(5.0, 0.0, 5.0);
        assert!(red[0] > 0.99 && red[1] < 0.02 && red[2] < 0.02, "{red:?}");
        let pale = colour(2.5, 0.0, 5.0);
        assert!((pale[0] - 1.0).abs() < 1e-6 && (pale[1] - 0.5).abs() < 0.02);
        assert!(colour(50.0, 0.0, 5.0)[0] < 0.8);
    }

    #[test]
    fn the_wheel_is_continuous_and_has_every_colour() {
        let steps = 1000;
        let colours: Vec<[f32; 3]> = (0..=steps).map(|i| wheel(i as f32 / steps as f32)).collect();
        for pair in colours.windows(2) {
            let jump = (0..3).map(|c| (pair[0][c] - pair[1][c]).abs()).fold(0.0, f32::max);
            assert!(jump < 0.02, "{pair:?}");
        }
        for c in 0..3 {
            assert!(colours.iter().any(|rgb| rgb[c] == 0.0) && colours.iter().any(|rgb| rgb[c] > 0.999));
        }
    }

    #[test]
    fn opposite_flows_differ_and_unknown_is_grey() {
        let flow = Planes::from_vec(2, 1, 4, vec![1.0, -1.0, f32::NAN, 1.0, 0.0, 0.0, 0.0, 0.0]);
        let mask = Mask::from_fn(1, 4, |_, x| x < 3);
        let image = picture(&flow, Some(&mask), 1.0);
        let at = |x: usize| [0, 1, 2].map(|c| image.at(c, 0, x));
        let distance: f32 = (0..3).map(|c| (at(0)[c] - at(1)[c]).abs()).sum();
        assert!(distance > 1.5, "{:?} {:?}", at(0), at(1));
        assert_eq!((at(2), at(3)), (UNKNOWN, UNKNOWN));
        assert_eq!(full_length_px(&flow, Some(&mask)), 1.0);
        assert!(image.data.iter().chain(&legend(17).data).all(|v| (0.0..=1.0).contains(v)));
    }
}
