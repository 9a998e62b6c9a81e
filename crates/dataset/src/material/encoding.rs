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
/// Words of 32 bits that hold a texel's numbers, whatever they are stored in.
pub(crate) const WORDS: usize = STORED.div_ceil(2);
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
pub(crate) trait Stored: Copy + Send + Sync + Default + 'static {
    /// The integer that stands for 0 in a normal.
    const CENTRE: f32;
    /// Largest integer.
    const MAX: f32;
    /// The integer as a float.
    fn widen(self) -> f32;
    /// Rounds and clamps.
    fn narrow(value: f32) -> Self;
    /// A texel's numbers packed into words of 32 bits, the first in the lowest bits.
    fn words(tap: &[Self; LANES]) -> [u32; WORDS];
    /// The word that holds a lane.
    fn word(lane: usize) -> usize;
    /// The number of a lane in its word.
    fn number<const LANE: usize>(word: u32) -> f32;
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
            #[inline(always)]
            fn words(tap: &[Self; LANES]) -> [u32; WORDS] {
                let mut words = [0; WORDS];
                for lane in 0..STORED {
                    words[Self::word(lane)] |= u32::from(tap[lane]) << (lane * <$int>::BITS as usize % 32);
                }
                words
            }
            #[inline(always)]
            fn word(lane: usize) -> usize {
                lane * <$int>::BITS as usize / 32
            }
            #[inline(always)]
            fn number<const LANE: usize>(word: u32) -> f32 {
                let shifted = word >> (LANE * <$int>::BITS as usize % 32);
                // Signed, which processors convert at once.
                (shifted & u32::from(<$int>::MAX)) as i32 as f32
            }
        }
    };
}

stored!(u8, 128.0);
stored!(u16, 32768.0);

/// A weighted sum of stored texels, kept in the units they are stored in until it is decoded once.
///
/// Written over fours of lanes because that is what the compiler turns into vector instructions (three conversions and
/// seven multiplications per tap on plain x86-64).
#[derive(Default)]
pub(crate) struct Sum {
    /// Σ weight·stored² of lanes 0–3 and 4–7: the colours.
    square: [[f32; 4]; 2],
    /// Σ weight·stored of lanes 4–7 and 8–11: roughness and normal.
    linear: [[f32; 4]; 2],
}

impl Sum {
    /// Adds `weight` times the texel at `index`.
    #[inline(always)]
    pub(crate) fn add<T: Stored>(&mut self, data: &[T], index: usize, weight: f32) {
        let tap: &[T; LANES] = data[index * STORED..].first_chunk().expect("levels end with spare numbers for the last tap");
        let quad = |k: usize| [tap[k].widen(), tap[k + 1].widen(), tap[k + 2].widen(), tap[k + 3].widen()];
        let (a, b, c) = (quad(0), quad(4), quad(8));
        for i in 0..4 {
            self.square[0][i] += a[i] * a[i] * weight;
        }
        for i in 0..4 {
            let weighted = b[i] * weight;
            self.linear[0][i] += weighted;
            self.square[1][i] += weighted * b[i];
        }
        for i in 0..4 {
            self.linear[1][i] += c[i] * weight;
        }
    }

    /// The decoded mean, for weights that add up to 1.
    #[inline(always)]
    pub(crate) fn decode<T: Stored>(&self) -> Lanes {
        let square = 1.0 / (T::MAX * T::MAX);
        let direction = 1.0 / (T::MAX - T::CENTRE);
        let ([a, b], [c, d]) = (self.square, self.linear);
        let mut lanes = [0.0; LANES];
        for i in 0..4 {
            lanes[i] = a[i] * square;
        }
        lanes[4] = b[0] * square;
        lanes[5] = b[1] * square;
        lanes[ROUGHNESS] = c[2] * (1.0 / T::MAX);
        lanes[NORMAL] = (c[3] - T::CENTRE) * direction;
        lanes[NORMAL + 1] = (d[0] - T::CENTRE) * direction;
        lanes
    }
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
        let mut sum = Sum::default();
        sum.add(&stored, 0, 1.0);
        texel_of(&sum.decode::<T>())
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
