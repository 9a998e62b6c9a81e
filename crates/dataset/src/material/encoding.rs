//! How one texel is stored: nine numbers of 8 or 16 bit, side by side, so that a tap touches one or two cache lines.
//!
//! Colours are stored as their square root (a gamma of 2): steps as fine in the dark as sRGB's, where linear 8 bit would
//! band, and decoded by one multiplication. Normals store x and y around a centre that stands for exactly 0 (128, as
//! normal-map files do); z follows from the unit length. Roughness is stored as it is.

use render::texel::Texel;

/// Numbers per stored texel.
pub(crate) const STORED: usize = 9;
/// Numbers of a texel that one vector holds; the ninth is summed by itself.
pub(crate) const VECTOR: usize = 8;
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

/// The values of a texel or of a mean of texels.
pub(crate) type Lanes = [f32; STORED];

/// An integer that texels are stored in.
pub(crate) trait Stored: Copy + Into<i32> + Send + Sync + Default + 'static {
    /// The integer that stands for 0 in a normal.
    const CENTRE: f32;
    /// Largest integer.
    const MAX: f32;
    /// The integer as a float.
    fn widen(self) -> f32;
    /// Rounds and clamps.
    fn narrow(value: f32) -> Self;
}

macro_rules! stored {
    ($int:ty, $centre:literal) => {
        impl Stored for $int {
            const CENTRE: f32 = $centre;
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

/// Σ weight·stored² of the colours and Σ weight·stored of roughness and normal.
///
/// The first eight numbers of a texel are one vector, the ninth (the normal's y) is alone: a block of samples sums the
/// ninths of all its pixels together.
#[derive(Clone, Copy, Default)]
pub(crate) struct Sum {
    first: [f32; VECTOR],
    ninth: f32,
}

impl Sum {
    /// Adds `weight` times a texel.
    #[inline(always)]
    pub(crate) fn add<T: Stored>(&mut self, texel: &[T; STORED], weight: f32) {
        add_first(&mut self.first, texel, weight);
        self.ninth += texel[VECTOR].widen() * weight;
    }

    /// Moves the sum towards another by a share of the way.
    #[inline(always)]
    pub(crate) fn mix(&mut self, other: &Self, share: f32) {
        for lane in 0..VECTOR {
            self.first[lane] += share * (other.first[lane] - self.first[lane]);
        }
        self.ninth += share * (other.ninth - self.ninth);
    }

    /// The mean in the units that texels are stored in, for weights that add up to 1; the normal's x and y times `sign`.
    #[inline(always)]
    pub(crate) fn mean<T: Stored>(&self, sign: [f32; 2]) -> Lanes {
        let mut lanes = [0.0; STORED];
        lanes[..VECTOR].copy_from_slice(&self.first);
        lanes[NORMAL] = around_centre::<T>(self.first[NORMAL], sign[0]);
        lanes[NORMAL + 1] = around_centre::<T>(self.ninth, sign[1]);
        lanes
    }
}

/// Adds `weight` times the first eight numbers of a texel, the colours squared.
#[inline(always)]
pub(super) fn add_first<T: Stored>(sum: &mut [f32; VECTOR], texel: &[T; STORED], weight: f32) {
    for lane in 0..VECTOR {
        let value = texel[lane].widen();
        let factor = if lane < ROUGHNESS { value } else { 1.0 };
        sum[lane] += value * factor * weight;
    }
}

/// A coordinate of the normal as it is stored, made 0 for flat ones.
#[inline(always)]
pub(super) fn around_centre<T: Stored>(stored: f32, sign: f32) -> f32 {
    (stored - T::CENTRE) * sign
}

/// What a lane of [`Sum::mean`] is multiplied by to be linear light, roughness, or a coordinate of the normal.
#[inline(always)]
pub(super) fn unit<T: Stored>(lane: usize) -> f32 {
    match lane {
        ..ROUGHNESS => 1.0 / (T::MAX * T::MAX),
        ROUGHNESS => 1.0 / T::MAX,
        _ => 1.0 / (T::MAX - T::CENTRE),
    }
}

/// The values that a [`Sum::mean`] stands for.
#[inline(always)]
pub(crate) fn decoded<T: Stored>(mean: &Lanes) -> Lanes {
    std::array::from_fn(|lane| mean[lane] * unit::<T>(lane))
}

/// Stores decoded values.
pub(crate) fn encode<T: Stored>(lanes: &Lanes, out: &mut [T]) {
    for lane in DIFFUSE..ROUGHNESS {
        out[lane] = T::narrow(lanes[lane].clamp(0.0, 1.0).sqrt() * T::MAX);
    }
    out[ROUGHNESS] = T::narrow(lanes[ROUGHNESS].clamp(0.0, 1.0) * T::MAX);
    for lane in NORMAL..STORED {
        out[lane] = T::narrow(lanes[lane].clamp(-1.0, 1.0) * (T::MAX - T::CENTRE) + T::CENTRE);
    }
}

/// The lanes of a texel, its normal made unit and kept off the horizon.
pub(crate) fn lanes_of(texel: &Texel) -> Lanes {
    let mut lanes = [0.0; STORED];
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
        let mut stored = [T::default(); STORED];
        encode(&lanes_of(texel), &mut stored);
        let mut sum = Sum::default();
        sum.add(&stored, 1.0);
        texel_of(&decoded::<T>(&sum.mean::<T>([1.0; 2])))
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
