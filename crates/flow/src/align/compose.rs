//! Composing the flows of neighbouring frames from the last regularised key frame (paper §5, "warp composition").

use ops::flow_field;
use ops::planes::{Mask, Planes};

/// A dense backward flow with the pixels on which it is known.
#[derive(Clone, Debug, PartialEq)]
pub struct FlowField {
    /// Two planes (x, y) in pixels.
    pub flow: Planes,
    /// Where the flow leads into the source.
    pub valid: Mask,
}

impl FlowField {
    /// No motion, known everywhere.
    pub fn still(height: usize, width: usize) -> Self {
        Self { flow: Planes::new(2, height, width), valid: Mask::new(height, width, true) }
    }

    /// A flow that is known wherever it stays inside a `height × width` source.
    pub fn inside(flow: Planes, height: usize, width: usize) -> Self {
        let valid = Mask::from_fn(flow.height, flow.width, |y, x| {
            let (sx, sy) = (x as f32 + flow.at(0, y, x), y as f32 + flow.at(1, y, x));
            sx >= 0.0 && sy >= 0.0 && sx <= (width - 1) as f32 && sy <= (height - 1) as f32
        });
        Self { flow, valid }
    }

    /// This flow, then `next`: target → middle → source. A point that leaves the middle image, or lands there where `next`
    /// is unknown, becomes invalid and stays so.
    pub fn then(&self, next: &Self) -> Self {
        let (flow, valid) = flow_field::compose(&self.flow, &self.valid, &next.flow, &next.valid);
        Self { flow, valid }
    }
}

/// All flows one after the other; `None` for no flow.
pub fn chain<'a>(flows: impl IntoIterator<Item = &'a FlowField>) -> Option<FlowField> {
    let mut flows = flows.into_iter();
    let first = flows.next()?.clone();
    Some(flows.fold(first, |whole, next| whole.then(next)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use ops::homography::Homography;

    fn field(x: f64, y: f64) -> FlowField {
        FlowField::inside(Homography::translation(x, y).flow(16, 20), 16, 20)
    }

    /// Equal flows where both are valid, and masks that differ at most along the border: a composed mask is the stricter
    /// the more often it was resampled.
    fn same(a: &FlowField, b: &FlowField) -> bool {
        let both = a.valid.and(&b.valid);
        let differing = a.valid.count().max(b.valid.count()) - both.count();
        let close = |i: usize| !both.data[i % 320] || (a.flow.data[i] - b.flow.data[i]).abs() < 1e-4;
        both.count() > 100 && differing <= 16 + 20 && (0..a.flow.data.len()).all(close)
    }

    #[test]
    fn composition_has_a_neutral_element_and_is_associative() {
        let (a, b, c) = (field(2.25, -1.5), field(1.0, 0.5), field(-0.75, 2.0));
        let still = FlowField::still(16, 20);
        assert!(same(&still.then(&a), &a) && same(&a.then(&still), &a));
        assert!(same(&a.then(&b).then(&c), &a.then(&b.then(&c))));
        assert!(same(&chain([&a, &b, &c]).unwrap(), &a.then(&b).then(&c)));
        assert!(chain([]).is_none());
    }

    #[test]
    fn a_point_that_left_the_frame_does_not_come_back() {
        let there = field(15.0, 0.0).then(&field(-15.0, 0.0));
        assert_eq!(there.valid.count(), 16 * 5);
        assert!((0..16).all(|y| there.valid.at(y, 4) && !there.valid.at(y, 5)));
        assert_eq!(field(100.0, 0.0).valid.count(), 0);
    }
}
