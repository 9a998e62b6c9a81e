//! How one texel is stored: nine numbers of 8 or 16 bit, side by side, so that a tap touches one cache line.
//!
//! Colours are stored as their square root (a gamma of 2): steps as fine in the dark as sRGB's, where linear 8 bit would
//! band, and decoded by one multiplication. Normals store x and y around a centre that stands for exactly 0 (128, as
//! normal-map files do); z follows from the unit length. Roughness is stored as it is.

use render::texel::Texel;

/// Numbers per stored texel.
pub(crate) const STORED: usize = 9;
/// Numbers that a tap reads: a multiple of the vector width; the last three belong to the next texel.
pub(crate) const LANES: usize = 12;
/// Lane of the diffuse red.
pub(crate) const DIFFUSE: usize = 0;
/// Lane of the specular red.
pub(crate) const SPECULAR: usize = 3;
/// Lane of the roughness.
pub(crate) const ROUGHNESS: usize = 6;
/// Lane of the normal's x; y follows.
pub(crate) const NORMAL: usize = 7;

/// Steepest storable normal: at z → 0 the root that recovers z has no stable derivative.
const MIN_NORMAL_Z: f32 = 0.05;

/// A tap's values, decoded to linear light.
pub(crate) type Lanes = [f32; LANES];

/// An integer that texels are stored in.
///
/// Every lane decodes as `y·(linear + square·y)` with `y = stored − centre`: one formula without a branch, so the compiler
/// can treat all lanes alike.
pub(crate) trait Stored: Copy + Send + Sync + Default + 'static {
    /// Subtracted before decoding, per lane.
    const CENTRE: Lanes;
    /// Weight of the value, per lane.
    const LINEAR: Lanes;
    /// Weight of the squared value, per lane.
    const SQUARE: Lanes;
    /// Largest integer.
    const MAX: f32;
    /// The integer as a float.
    fn widen(self) -> f32;
    /// Rounds and clamps.
    fn narrow(value: f32) -> Self;
}

const fn centre(half: f32) -> Lanes {
    let mut lanes = [0.0; LANES];
    lanes[NORMAL] = half;
    lanes[NORMAL + 1] = half;
    lanes
}

const fn linear(max: f32, half: f32) -> Lanes {
    let mut lanes = [0.0; LANES];
    lanes[ROUGHNESS] = 1.0 / max;
    lanes[NORMAL] = 1.0 / (max - half);
    lanes[NORMAL + 1] = 1.0 / (max - half);
    lanes
}

const fn square(max: f32) -> Lanes {
    let mut lanes = [0.0; LANES];
    let mut i = 0;
    while i < ROUGHNESS {
        lanes[i] = 1.0 / (max * max);
        i += 1;
    }
    lanes
}

macro_rules! stored {
    ($int:ty, $half:literal) => {
        impl Stored for $int {
            const CENTRE: Lanes = centre($half);
            const LINEAR: Lanes = linear(<$int>::MAX as f32, $half);
            const SQUARE: Lanes = square(<$int>::MAX as f32);
            const MAX: f32 = <$int>::MAX as f32;
            #[inline(always)]
            fn widen(self) -> f32 {
                f32::from(self)
            }
            #[inline(always)]
            fn narrow(value: f32) -> Self {
                (value + 0.5) as $int
            }
        }
    };
}

stored!(u8, 128.0);
stored!(u16, 32768.0);

/// Adds `weight` times the decoded texel at `index` to `sum`.
#[inline(always)]
pub(crate) fn accumulate<T: Stored>(sum: &mut Lanes, data: &[T], index: usize, weight: f32) {
    let tap = &data[index * STORED..][..LANES];
    for lane in 0..LANES {
        let y = tap[lane].widen() - T::CENTRE[lane];
        sum[lane] += weight * (y * (T::LINEAR[lane] + T::SQUARE[lane] * y));
    }
}

/// Stores decoded values.
pub(crate) fn encode<T: Stored>(lanes: &Lanes, out: &mut [T]) {
    let half = T::CENTRE[NORMAL];
    for lane in DIFFUSE..ROUGHNESS {
        out[lane] = T::narrow(lanes[lane].clamp(0.0, 1.0).sqrt() * T::MAX);
    }
    out[ROUGHNESS] = T::narrow(lanes[ROUGHNESS].clamp(0.0, 1.0) * T::MAX);
    for lane in NORMAL..STORED {
        out[lane] = T::narrow(lanes[lane].clamp(-1.0, 1.0) * (T::MAX - half) + half);
    }
}

/// The lanes of a texel, its normal made unit and kept off the horizon.
pub(crate) fn lanes_of(texel: &Texel) -> Lanes {
    let mut lanes = [0.0; LANES];
    lanes[DIFFUSE..SPECULAR].copy_from_slice(&texel.diffuse);
    lanes[SPECULAR..ROUGHNESS].copy_from_slice(&texel.specular);
    lanes[ROUGHNESS] = texel.roughness;
    let [x, y, z] = texel.normal;
    let z = z.max(MIN_NORMAL_Z * (x * x + y * y + z * z).sqrt()).max(1e-6);
    let length = (x * x + y * y + z * z).sqrt();
    lanes[NORMAL] = x / length;
    lanes[NORMAL + 1] = y / length;
    lanes
}

/// The texel of (interpolated) lanes: z completes the normal to unit length.
#[inline(always)]
pub(crate) fn texel_of(lanes: &Lanes) -> Texel {
    let (x, y) = (lanes[NORMAL], lanes[NORMAL + 1]);
    Texel {
        normal: [x, y, normal_z(x, y)],
        diffuse: [lanes[0], lanes[1], lanes[2]],
        specular: [lanes[3], lanes[4], lanes[5]],
        roughness: lanes[ROUGHNESS],
    }
}

/// The z that makes (x, y, z) a unit vector; 0 where rounding pushed x² + y² above 1.
#[inline(always)]
pub(crate) fn normal_z(x: f32, y: f32) -> f32 {
    (1.0 - x * x - y * y).max(0.0).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn round_trip<T: Stored>(texel: &Texel) -> Texel {
        let mut stored = vec![T::default(); LANES];
        encode(&lanes_of(texel), &mut stored);
        let mut sum = [0.0; LANES];
        accumulate(&mut sum, &stored, 0, 1.0);
        texel_of(&sum)
    }

    #[test]
    fn a_stored_texel_comes_back_within_half_a_step() {
        let texel =
            Texel { normal: [0.28, -0.6, 0.749_4], diffuse: [0.0, 0.01, 1.0], roughness: 0.4, specular: [0.04, 0.5, 0.9] };
        let back = round_trip::<u8>(&texel);
        for c in 0..3 {
            // Half a step of a square-root code is √v/255 in linear light.
            assert!((back.diffuse[c] - texel.diffuse[c]).abs() <= texel.diffuse[c].sqrt() / 255.0 + 1e-5);
            assert!((back.specular[c] - texel.specular[c]).abs() <= texel.specular[c].sqrt() / 255.0 + 1e-5);
            assert!((back.normal[c] - texel.normal[c]).abs() < 0.008);
        }
        assert!((back.roughness - 0.4).abs() <= 0.5 / 255.0 + 1e-6);
        let fine = round_trip::<u16>(&texel);
        assert!((fine.normal[0] - 0.28).abs() < 3e-5 && (fine.specular[0] - 0.04).abs() < 1e-5);
    }

    #[test]
    fn a_flat_normal_is_stored_without_tilt_and_a_horizontal_one_is_lifted() {
        let mut texel = Texel { normal: [0.0, 0.0, 1.0], diffuse: [0.5; 3], roughness: 0.5, specular: [0.04; 3] };
        assert_eq!(round_trip::<u8>(&texel).normal, [0.0, 0.0, 1.0]);
        texel.normal = [1.0, 0.0, 0.0];
        let lifted = round_trip::<u16>(&texel).normal;
        assert!(lifted[2] > 0.04 && lifted[0] > 0.99, "{lifted:?}");
    }
}
