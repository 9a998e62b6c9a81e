//! Threads over and under each other, and the loops of a knit.

use crate::material::procedural::field::{TILE, smoothstep};

/// Which thread lies on top where.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Draft {
    /// Over one, under one.
    Plain,
    /// Groups of `n` threads over and under.
    Basket(usize),
    /// Warp over `over`, under `under`, shifted by one each row: diagonal ribs.
    Twill {
        /// Wefts that a warp thread passes over.
        over: usize,
        /// Wefts that it passes under.
        under: usize,
    },
    /// Warp over four, under one, scattered bindings: smooth.
    Satin,
}

impl Draft {
    /// Threads after which the draft repeats.
    pub fn period(self) -> usize {
        match self {
            Self::Plain => 2,
            Self::Basket(n) => 2 * n,
            Self::Twill { over, under } => over + under,
            Self::Satin => 5,
        }
    }

    fn warp_on_top(self, end: usize, pick: usize) -> bool {
        match self {
            Self::Plain => (end + pick).is_multiple_of(2),
            Self::Basket(n) => (end / n + pick / n).is_multiple_of(2),
            Self::Twill { over, under } => (end + pick) % (over + under) < over,
            Self::Satin => !(end + 2 * pick).is_multiple_of(5),
        }
    }
}

/// A cloth of `ends` warp threads (vertical) and `picks` weft threads (horizontal) per tile.
#[derive(Clone, Copy, Debug)]
pub struct Weave {
    ends: usize,
    picks: usize,
    draft: Draft,
    fill: [f32; 2],
}

/// The thread on top at a position.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Thread {
    /// True for a warp thread.
    pub warp: bool,
    /// Its number from the left or the top.
    pub index: usize,
    /// Position along the thread in reference texels.
    pub along: f32,
    /// Position across, −1 to 1 at the thread's sides.
    pub across: f32,
    /// Height of the surface, about −1 (between threads) to 1, in thread radii.
    pub height: f32,
}

impl Weave {
    /// Threads `warp` and `weft` reference texels apart, rounded so that the draft closes; `fill` is the share of that distance that
    /// warp and weft threads fill.
    pub fn new(warp: f32, weft: f32, draft: Draft, fill: [f32; 2]) -> Self {
        let count = |pitch: f32| (TILE / pitch / draft.period() as f32).round().max(1.0) as usize * draft.period();
        Self { ends: count(warp), picks: count(weft), draft, fill }
    }

    /// Number of warp and of weft threads per tile.
    pub fn threads(&self) -> [usize; 2] {
        [self.ends, self.picks]
    }

    /// The topmost thread at a position (wraps around).
    #[inline]
    pub fn at(&self, x: f32, y: f32) -> Thread {
        let (x, y) = (x / TILE, y / TILE);
        let (u, v) = ((x - x.floor()) * self.ends as f32, (y - y.floor()) * self.picks as f32);
        let (end, pick) = ((u as usize).min(self.ends - 1), (v as usize).min(self.picks - 1));
        let (s, t) = (2.0 * (u - end as f32) - 1.0, 2.0 * (v - pick as f32) - 1.0);
        let here = self.lift(end, pick);
        let beside = self.lift(step(end, s, self.ends), pick);
        let ahead = self.lift(end, step(pick, t, self.picks));
        let warp = 0.5 * bend(here, ahead, t) + round(s / self.fill[0]);
        let weft = -0.5 * bend(here, beside, s) + round(t / self.fill[1]);
        if warp >= weft {
            Thread { warp: true, index: end, along: y * TILE, across: s / self.fill[0], height: warp }
        } else {
            Thread { warp: false, index: pick, along: x * TILE, across: t / self.fill[1], height: weft }
        }
    }

    fn lift(&self, end: usize, pick: usize) -> f32 {
        if self.draft.warp_on_top(end, pick) { 1.0 } else { -1.0 }
    }
}

/// The neighbour on the side that `offset` points to.
#[inline]
fn step(index: usize, offset: f32, count: usize) -> usize {
    if offset >= 0.0 { (index + 1) % count } else { (index + count - 1) % count }
}

/// Height of a thread's axis between the crossing `here` and the next one.
#[inline]
fn bend(here: f32, next: f32, offset: f32) -> f32 {
    let t = 0.5 * offset.abs();
    here + (next - here) * smoothstep(0.1, 0.9, t)
}

/// Cross-section of a thread: a half circle of height 0.5 that falls away steeply beyond its sides.
#[inline]
fn round(across: f32) -> f32 {
    let inside = 1.0 - across * across;
    if inside > 0.0 { 0.5 * inside.sqrt() } else { (0.8 * inside).max(-0.7) }
}

/// A stitch of a plain knit at a position.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stitch {
    /// Column (wale) and row (course) of the stitch.
    pub index: [usize; 2],
    /// Position along the yarn within the stitch, 0 to 1.
    pub along: f32,
    /// Position across the yarn, −1 to 1.
    pub across: f32,
    /// Height, 0 at the gaps to 1.
    pub height: f32,
}

/// A plain knit (stockinette): columns of V-shaped stitches.
#[derive(Clone, Copy, Debug)]
pub struct Knit {
    wales: usize,
    courses: usize,
    lean: f32,
}

impl Knit {
    /// Stitches `width × height` reference texels; `lean` (about 0.8) is how much a leg rises over its width, in stitch heights.
    pub fn new(width: f32, height: f32, lean: f32) -> Self {
        let count = |pitch: f32| (TILE / pitch).round().max(2.0) as usize;
        Self { wales: count(width), courses: count(height), lean }
    }

    /// The stitch at a position (wraps around).
    #[inline]
    pub fn at(&self, x: f32, y: f32) -> Stitch {
        let (x, y) = (x / TILE, y / TILE);
        let u = (x - x.floor()) * self.wales as f32;
        let wale = (u as usize).min(self.wales - 1);
        // Distance from the middle of the V: 0 at its foot, 1 at the outer end of a leg. The foot is the lowest point (y is down).
        let leg = (2.0 * (u - wale as f32) - 1.0).abs();
        let v = (y - y.floor()) * self.courses as f32 + self.lean * leg;
        let course = v.floor();
        let across = 2.0 * (v - course) - 1.0;
        let (side, end) = ((1.0 - across * across).max(0.0).sqrt(), 1.0 - (2.0 * leg - 1.0).powi(2));
        let index = [wale, (course as usize) % self.courses];
        Stitch { index, along: leg, across, height: side * (0.35 + 0.65 * end.max(0.0).sqrt()) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::material::procedural::noise::unit;

    /// Share of crossings where the warp is on top, read at the middle of every crossing.
    fn warp_share(draft: Draft) -> f32 {
        let weave = Weave::new(20.0, 25.0, draft, [1.0, 1.0]);
        let [ends, picks] = weave.threads();
        let tops = (0..picks).flat_map(|j| (0..ends).map(move |i| (i, j))).filter(|&(i, j)| {
            let at = |k: usize, count: usize| (k as f32 + 0.5) * TILE / count as f32;
            weave.at(at(i, ends), at(j, picks)).warp
        });
        tops.count() as f32 / (ends * picks) as f32
    }

    #[test]
    fn drafts_bring_the_warp_to_the_top_as_often_as_they_say() {
        assert_eq!(warp_share(Draft::Plain), 0.5);
        assert_eq!(warp_share(Draft::Basket(2)), 0.5);
        assert_eq!(warp_share(Draft::Twill { over: 3, under: 1 }), 0.75);
        assert_eq!(warp_share(Draft::Satin), 0.8);
    }

    #[test]
    fn weaves_and_knits_wrap_around() {
        for draft in [Draft::Plain, Draft::Basket(3), Draft::Twill { over: 2, under: 1 }, Draft::Satin] {
            let weave = Weave::new(17.0, 23.0, draft, [0.9, 0.9]);
            let knit = Knit::new(31.0, 22.0, 0.8);
            for k in 0..500 {
                let (x, y) = (unit(k, 0) * TILE, unit(k, 1) * TILE);
                let apart = weave.at(x, y).height - weave.at(x + TILE, y - TILE).height;
                assert!(apart.abs() < 0.02, "{draft:?} {x} {y}: {apart}");
                let apart = knit.at(x, y).height - knit.at(x - TILE, y + TILE).height;
                assert!(apart.abs() < 0.05, "knit {x} {y}: {apart}");
            }
        }
    }
}
