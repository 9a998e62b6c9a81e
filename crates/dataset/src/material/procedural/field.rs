//! Scalar fields over one tile that wrap around at its edges, and the operations that families are made of.
//!
//! # Units
//! Lengths are *reference texels*: a tile is [`TILE`] of them wide at every resolution, x to the right and y DOWN. Heights
//! use the same unit, so slopes don't change with the resolution.

/// Reference texels per tile edge: the unit of every length of the generators.
pub const TILE: f32 = 1024.0;

/// A periodic scalar field, sampled at the centres of `size × size` texels.
#[derive(Clone, Debug, PartialEq)]
pub struct Field {
    /// Texels per edge.
    pub size: usize,
    /// Row-major values.
    pub data: Vec<f32>,
}

impl Field {
    /// The same value everywhere.
    pub fn constant(size: usize, value: f32) -> Self {
        Self { size, data: vec![value; size * size] }
    }

    /// A field from a function of the position in reference texels.
    pub fn from_fn(size: usize, mut f: impl FnMut(f32, f32) -> f32) -> Self {
        let step = TILE / size as f32;
        let mut data = Vec::with_capacity(size * size);
        for row in 0..size {
            let y = (row as f32 + 0.5) * step;
            data.extend((0..size).map(|column| f((column as f32 + 0.5) * step, y)));
        }
        Self { size, data }
    }

    /// Applies a function to every value.
    pub fn map(mut self, f: impl Fn(f32) -> f32) -> Self {
        self.data.iter_mut().for_each(|v| *v = f(*v));
        self
    }

    /// Combines two fields value by value.
    pub fn zip(mut self, other: &Self, f: impl Fn(f32, f32) -> f32) -> Self {
        self.data.iter_mut().zip(&other.data).for_each(|(a, b)| *a = f(*a, *b));
        self
    }

    /// `self + weight · other`.
    pub fn plus(self, weight: f32, other: &Self) -> Self {
        self.zip(other, |a, b| a + weight * b)
    }

    /// Bilinear sample at a position in reference texels; positions wrap around.
    #[inline]
    pub fn sample(&self, x: f32, y: f32) -> f32 {
        let scale = self.size as f32 / TILE;
        let (x, y) = (x * scale - 0.5, y * scale - 0.5);
        let (x0, y0) = (floor(x), floor(y));
        let (fx, fy) = (x - x0 as f32, y - y0 as f32);
        let (left, top) = (wrap(x0, self.size), wrap(y0, self.size));
        let right = if left + 1 == self.size { 0 } else { left + 1 };
        let below = if top + 1 == self.size { 0 } else { top + 1 };
        let (upper, lower) = (&self.data[top * self.size..][..self.size], &self.data[below * self.size..][..self.size]);
        let a = upper[left] + fx * (upper[right] - upper[left]);
        let b = lower[left] + fx * (lower[right] - lower[left]);
        a + fy * (b - a)
    }

    /// The field looked up at positions displaced by `amount · (dx, dy)` reference texels.
    pub fn warped(&self, dx: &Self, dy: &Self, amount: f32) -> Self {
        let mut texel = 0;
        Self::from_fn(self.size, |x, y| {
            let value = self.sample(x + amount * dx.data[texel], y + amount * dy.data[texel]);
            texel += 1;
            value
        })
    }

    /// A smoothed copy: three periodic box filters of half width `radius` reference texels (close to a Gaussian of that σ).
    pub fn blur(&self, radius: f32) -> Self {
        let half = (radius * self.size as f32 / TILE).round() as usize;
        if half == 0 {
            return self.clone();
        }
        let half = half.min((self.size - 1) / 2);
        let (mut a, mut b) = (self.data.clone(), vec![0.0; self.data.len()]);
        for _ in 0..3 {
            box_rows(&a, &mut b, self.size, half);
            box_columns(&b, &mut a, self.size, half);
        }
        Self { size: self.size, data: a }
    }

    /// How far each texel lies above the smoothed surface, in reference texels: negative in crevices, positive on edges.
    pub fn relief(&self, radius: f32) -> Self {
        self.blur(radius).zip(self, |smooth, here| here - smooth)
    }

    /// The value below which a `share` in [0, 1] of the field lies, read from a regular subset of the texels.
    pub fn quantile(&self, share: f32) -> f32 {
        let stride = (self.data.len() / 8192).max(1) | 1;
        let mut subset: Vec<f32> = self.data.iter().copied().step_by(stride).collect();
        let at = ((subset.len() - 1) as f32 * share.clamp(0.0, 1.0)) as usize;
        *subset.select_nth_unstable_by(at, f32::total_cmp).1
    }

    /// 1 where the field is in its upper `share`, 0 in the rest, with a ramp `softness` wide (in the field's unit).
    pub fn upper_share(&self, share: f32, softness: f32) -> Self {
        let threshold = self.quantile(1.0 - share);
        self.clone().map(|v| smoothstep(threshold - softness, threshold + softness, v))
    }
}

/// The whole number at or below `x`; without SSE4.1 `f32::floor` is a call into the C library.
#[inline]
fn floor(x: f32) -> i32 {
    let towards_zero = x as i32;
    towards_zero - i32::from(x < towards_zero as f32)
}

/// A texel index wrapped into `0..size`.
#[inline]
pub fn wrap(index: i32, size: usize) -> usize {
    if size.is_power_of_two() { index as usize & (size - 1) } else { index.rem_euclid(size as i32) as usize }
}

/// Linear interpolation from `a` to `b`.
#[inline]
pub fn lerp(a: f32, b: f32, t: f32) -> f32 {
    a + t * (b - a)
}

/// 0 below `low`, 1 above `high`, a cubic between.
#[inline]
pub fn smoothstep(low: f32, high: f32, x: f32) -> f32 {
    let t = ((x - low) / (high - low)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

fn box_rows(from: &[f32], to: &mut [f32], size: usize, half: usize) {
    let weight = 1.0 / (2 * half + 1) as f32;
    for (source, target) in from.chunks_exact(size).zip(to.chunks_exact_mut(size)) {
        let mut sum: f32 = (0..=2 * half).map(|k| source[(k + size - half) % size]).sum();
        for x in 0..size {
            target[x] = sum * weight;
            let (enter, leave) = (x + half + 1, x + size - half);
            sum += source[if enter >= size { enter - size } else { enter }];
            sum -= source[if leave >= size { leave - size } else { leave }];
        }
    }
}

fn box_columns(from: &[f32], to: &mut [f32], size: usize, half: usize) {
    let weight = 1.0 / (2 * half + 1) as f32;
    let row = |y: usize| &from[(y % size) * size..][..size];
    let mut sums = vec![0.0f32; size];
    for k in 0..=2 * half {
        sums.iter_mut().zip(row(k + size - half)).for_each(|(s, v)| *s += v);
    }
    for (y, target) in to.chunks_exact_mut(size).enumerate() {
        let (enter, leave) = (row(y + half + 1), row(y + size - half));
        for (((t, s), e), l) in target.iter_mut().zip(&mut sums).zip(enter).zip(leave) {
            *t = *s * weight;
            *s += e - l;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bumps(size: usize) -> Field {
        Field::from_fn(size, |x, y| (x * 0.05).sin() + (y * 0.11).cos() + if x < 300.0 { 1.0 } else { 0.0 })
    }

    #[test]
    fn samples_at_texel_centres_are_the_texels_and_wrap() {
        for size in [16, 24] {
            let field = bumps(size);
            let step = TILE / size as f32;
            for (k, &value) in field.data.iter().enumerate() {
                let (x, y) = ((k % size) as f32 + 0.5, (k / size) as f32 + 0.5);
                assert!((field.sample(x * step, y * step) - value).abs() < 1e-4);
                assert!((field.sample(x * step - TILE, y * step + TILE) - value).abs() < 1e-3);
            }
        }
    }

    #[test]
    fn blurring_keeps_the_mean_and_takes_contrast() {
        let (field, smooth) = (bumps(64), bumps(64).blur(40.0));
        let mean = |f: &Field| f.data.iter().sum::<f32>() / f.data.len() as f32;
        let spread = |f: &Field| f.data.iter().map(|v| (v - mean(f)).powi(2)).sum::<f32>();
        assert!((mean(&field) - mean(&smooth)).abs() < 1e-3);
        assert!(spread(&smooth) < 0.7 * spread(&field));
        assert_eq!(field.blur(0.0), field);
    }

    /// A unit impulse spreads to the same weights left, right, above and below, also over the edge.
    #[test]
    fn blurring_is_symmetric_and_periodic() {
        let size = 32;
        let mut field = Field::constant(size, 0.0);
        field.data[0] = 1.0;
        let smooth = field.blur(2.0 * TILE / size as f32);
        for k in 1..8 {
            let across = [k, size - k, k * size, (size - k) * size].map(|t| smooth.data[t]);
            assert!(across.iter().all(|v| (v - across[0]).abs() < 1e-6), "{k}: {across:?}");
        }
        assert!((smooth.data.iter().sum::<f32>() - 1.0).abs() < 1e-4);
    }

    #[test]
    fn shares_cover_what_they_say() {
        let field = Field::from_fn(128, |x, y| (x * 0.731).fract() + (y * 0.377).fract());
        for share in [0.1, 0.35, 0.8] {
            let cover = field.upper_share(share, 1e-3);
            let covered = cover.data.iter().sum::<f32>() / cover.data.len() as f32;
            assert!((covered - share).abs() < 0.03, "{share}: {covered}");
        }
    }
}
