//! A material in memory: texels in stored precision, sampled by addressing.

use render::block::{Lane, TexelBlock};
use render::texel::Texel;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::encoding::{Lanes, ROUGHNESS, SPECULAR, STORED, Stored, decoded, lanes_of, texel_of};
use super::levels::{LEVEL_LOG2, Level, chain, coarse, mix, octave_of, pitch_bytes, whole_and_fraction};
use super::{MaterialError, MaterialMaps, block};

/// Texels of the virtual grid over the material's [−1, 1]² (paper §4: 4096² maps).
pub const GRID: usize = 4096;
/// Largest cost of one material; maps of 16 bit are stored in 8 bit when they would cost more.
pub const MAX_BYTES: usize = 200_000_000;

/// Longest side of a tile that comes from files: the grid has no more texels, and [`MAX_BYTES`] is made for it.
pub const MAX_STORED_SIDE: usize = GRID;

/// Longest side of any tile: places of its numbers fit in 32 bits.
const MOST_SIDE: usize = 16_384;

/// How a tile continues beyond its edge.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Wrap {
    /// The tile repeats: right for tileable maps.
    #[default]
    Repeat,
    /// Every second tile is mirrored, with the normal's x or y negated (paper Fig. 2): for maps that don't tile.
    Mirror,
}

/// The two neighbouring texels of a tile along one axis.
pub(crate) struct Pair {
    pub index: [u32; 2],
    /// −1 where the texel is seen in a mirror.
    pub sign: [f32; 2],
}

impl Pair {
    #[inline(always)]
    pub(crate) fn seam(&self) -> bool {
        self.sign[0] != self.sign[1]
    }
}

impl Wrap {
    /// Texels `first` and `first + 1` of an endless axis, as texels of a tile of `size`.
    #[inline(always)]
    pub(crate) fn pair(self, first: i32, size: i32) -> Pair {
        match self {
            Self::Repeat => {
                let a = modulo(first, size);
                let b = if a + 1 == size { 0 } else { a + 1 };
                Pair { index: [a as u32, b as u32], sign: [1.0; 2] }
            }
            Self::Mirror => {
                let a = modulo(first, 2 * size);
                let b = if a + 1 == 2 * size { 0 } else { a + 1 };
                let fold = |i: i32| if i < size { (i as u32, 1.0) } else { ((2 * size - 1 - i) as u32, -1.0) };
                let ((a, sign_a), (b, sign_b)) = (fold(a), fold(b));
                Pair { index: [a, b], sign: [sign_a, sign_b] }
            }
        }
    }
}

/// Remainder ≥ 0 of a value within ±2²³, whose quotient is at most one off in `f32`: vectors have no division of whole numbers.
#[inline(always)]
fn modulo(value: i32, period: i32) -> i32 {
    let (quotient, _) = whole_and_fraction(value as f32 * (1.0 / period as f32));
    let rest = value - quotient * period;
    let rest = if rest < 0 { rest + period } else { rest };
    if rest >= period { rest - period } else { rest }
}

/// What is known of a material besides its texels.
#[derive(Clone, Debug, PartialEq)]
pub struct MaterialInfo {
    /// Name shown to people: folder name, or family and seed.
    pub name: String,
    /// What the split is decided by ([`super::split`]): the same for one scan in several colours or sizes.
    pub identity: String,
    /// Kind and place it came from, like `pbr textures/Bricks075B` or `procedural brick`.
    pub source: String,
    /// Licence of the maps.
    pub licence: String,
    /// Whether a frame of it shows enough detail to align by; `None` asks [`super::texture`] to measure.
    pub textured: Option<bool>,
    /// How it continues beyond its tile.
    pub wrap: Wrap,
    /// Texels of the maps over the material's [−1, 1]² along x; [`GRID`] shows every texel as one texel of the grid.
    pub texels: usize,
}

impl MaterialInfo {
    /// Of a material that a program makes up: its tile repeats and covers [`GRID`] texels, and it shows enough to align by.
    pub fn made_up(name: &str) -> Self {
        Self {
            name: name.into(),
            identity: name.into(),
            source: format!("made up: {name}"),
            licence: "CC0-1.0".into(),
            textured: Some(true),
            wrap: Wrap::Repeat,
            texels: GRID,
        }
    }
}

/// Bits per stored number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Precision {
    /// 8 bit: the default, and right for 8-bit files.
    Eight,
    /// 16 bit, for maps of 16-bit files; falls back to 8 bit above [`MAX_BYTES`].
    Sixteen,
}

/// Largest value of each map over all channels.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Maxima {
    /// Of the diffuse albedo.
    pub diffuse: f32,
    /// Of the specular albedo.
    pub specular: f32,
    /// Of the roughness.
    pub roughness: f32,
}

#[derive(Clone, Debug)]
enum Levels {
    Eight(Vec<Level<u8>>),
    Sixteen(Vec<Level<u16>>),
}

/// The maps of one material.
#[derive(Clone, Debug)]
pub struct Material {
    info: MaterialInfo,
    maxima: Maxima,
    /// Texels of level 0 per texel of the grid.
    scale: f32,
    levels: Levels,
}

impl Material {
    /// Stores the texels that `texel(column, row)` gives for a tile; row 0 is the top.
    ///
    /// # Errors
    /// [`MaterialError::Size`] for an empty or huge tile, [`MaterialError::NonFinite`] when a texel holds NaN or infinity.
    pub fn build(
        info: MaterialInfo,
        width: usize,
        height: usize,
        precision: Precision,
        texel: impl Fn(usize, usize) -> Texel + Sync,
    ) -> Result<Self, MaterialError> {
        if !(1..=MOST_SIDE).contains(&width) || !(1..=MOST_SIDE).contains(&height) || info.texels == 0 {
            return Err(MaterialError::Size { name: info.name, width, height });
        }
        let bad = std::sync::atomic::AtomicBool::new(false);
        let lanes = |x: usize, y: usize| {
            let lanes = lanes_of(&texel(x, y));
            if !lanes.iter().all(|v| v.is_finite()) {
                bad.store(true, std::sync::atomic::Ordering::Relaxed);
            }
            lanes
        };
        let sixteen = precision == Precision::Sixteen && bytes(width, height, 2) <= MAX_BYTES;
        let (levels, maxima) = if sixteen {
            let finest = Level::<u16>::from_fn(width, height, lanes);
            let maxima = maxima(&finest);
            (Levels::Sixteen(chain(finest)), maxima)
        } else {
            let finest = Level::<u8>::from_fn(width, height, lanes);
            let maxima = maxima(&finest);
            (Levels::Eight(chain(finest)), maxima)
        };
        if bad.into_inner() {
            return Err(MaterialError::NonFinite { name: info.name });
        }
        let scale = info.texels as f32 / GRID as f32;
        let mut material = Self { info, maxima, scale, levels };
        if material.info.textured.is_none() {
            material.info.textured = Some(super::texture::is_textured(&material));
        }
        Ok(material)
    }

    /// Stores float maps in 8 bit.
    ///
    /// # Errors
    /// As [`Material::build`].
    pub fn from_maps(info: MaterialInfo, maps: &MaterialMaps) -> Result<Self, MaterialError> {
        let three = |planes: &ops::planes::Planes, x: usize, y: usize| std::array::from_fn(|c| planes.at(c, y, x));
        Self::build(info, maps.width(), maps.height(), Precision::Eight, |x, y| Texel {
            normal: three(&maps.normal, x, y),
            diffuse: three(&maps.diffuse, x, y),
            roughness: maps.roughness.at(0, y, x),
            specular: three(&maps.specular, x, y),
        })
    }

    /// The reflectance at a place of the grid, averaged over a pixel's footprint.
    ///
    /// Below one texel per pixel it interpolates bilinearly between the finest texels; above, between mip levels too.
    ///
    /// # Units
    /// `tx`, `ty`: texels of the virtual [`GRID`] over [−1, 1]² (`tx = (X+1)/2·GRID − 0.5`, `ty = (1−Y)/2·GRID − 0.5`), any
    /// value: the tile goes on for ever. `footprint`: width of a pixel in texels of the same grid.
    #[inline(always)]
    pub fn sample(&self, tx: f32, ty: f32, footprint: f32) -> Texel {
        let x = (tx + 0.5) * self.scale - 0.5;
        let y = (ty + 0.5) * self.scale - 0.5;
        let footprint = footprint * self.scale;
        let lanes = match &self.levels {
            Levels::Eight(levels) => filtered(levels, x, y, footprint, self.info.wrap),
            Levels::Sixteen(levels) => filtered(levels, x, y, footprint, self.info.wrap),
        };
        texel_of(&lanes)
    }

    /// [`Material::sample`] at the places of a block, with the same bits.
    #[inline(always)]
    pub fn sample_block(&self, tx: &Lane, ty: &Lane, footprint: &Lane) -> TexelBlock {
        let stored = |t: &Lane| t.map(|t| (t + 0.5) * self.scale - 0.5);
        let (x, y, footprint) = (stored(tx), stored(ty), footprint.map(|f| f * self.scale));
        match &self.levels {
            Levels::Eight(levels) => block::texels(levels, [&x, &y], &footprint, self.info.wrap),
            Levels::Sixteen(levels) => block::texels(levels, [&x, &y], &footprint, self.info.wrap),
        }
    }

    /// Name shown to people.
    pub fn name(&self) -> &str {
        &self.info.name
    }

    /// Everything known besides the texels; `textured` is always decided.
    pub fn info(&self) -> &MaterialInfo {
        &self.info
    }

    /// Whether frames of it show enough detail to align by.
    pub fn textured(&self) -> bool {
        self.info.textured.unwrap_or(true)
    }

    /// Largest stored values.
    pub fn maxima(&self) -> Maxima {
        self.maxima
    }

    /// Columns and rows of the tile.
    pub fn size(&self) -> [usize; 2] {
        match &self.levels {
            Levels::Eight(levels) => [levels[0].width, levels[0].height],
            Levels::Sixteen(levels) => [levels[0].width, levels[0].height],
        }
    }

    /// Texels of the grid per texel of the tile.
    pub fn texel_size(&self) -> f32 {
        1.0 / self.scale
    }

    /// Memory that the texels take.
    ///
    /// # Units
    /// Bytes.
    pub fn bytes(&self) -> usize {
        match &self.levels {
            Levels::Eight(levels) => levels.iter().map(|l| l.data.len()).sum(),
            Levels::Sixteen(levels) => levels.iter().map(|l| 2 * l.data.len()).sum(),
        }
    }
}

/// Bytes of a tile with its levels, its numbers of `number` bytes each.
fn bytes(width: usize, height: usize, number: usize) -> usize {
    LEVEL_LOG2.iter().map(|l| pitch_bytes(width >> l, STORED * number) * (height >> l)).sum()
}

/// The sample of a footprint at (x, y), both in texels of level 0.
#[inline(always)]
pub(super) fn filtered<T: Stored>(levels: &[Level<T>], x: f32, y: f32, footprint: f32, wrap: Wrap) -> Lanes {
    if footprint <= 1.0 || footprint.is_nan() {
        return decoded::<T>(&levels[0].bilinear(x, y, wrap));
    }
    let (octave, weight) = octave_of(footprint, levels.len());
    if octave >= 2 {
        return decoded::<T>(&coarse(levels, (octave, weight), x, y, wrap));
    }
    // Up to here every level is stored.
    let (fine, coarser) = (&levels[octave], &levels[(octave + 1).min(levels.len() - 1)]);
    let (a, b) = (fine.corners(x, y, wrap), coarser.corners(x, y, wrap));
    if let (Some(sign), Some(same)) = (a.sign(), b.sign())
        && sign == same
    {
        let mut sum = fine.sum(&a);
        if weight > 0.0 {
            sum.mix(&coarser.sum(&b), weight);
        }
        return decoded::<T>(&sum.mean::<T>(sign));
    }
    let mut mean = fine.mean(&a);
    if weight > 0.0 {
        mix(&mut mean, &coarser.mean(&b), weight);
    }
    decoded::<T>(&mean)
}

fn maxima<T: Stored>(level: &Level<T>) -> Maxima {
    let mut top = [0.0f32; STORED];
    for y in 0..level.height {
        for x in 0..level.width {
            let lanes = level.texel(x, y);
            for lane in 0..=ROUGHNESS {
                top[lane] = top[lane].max(lanes[lane]);
            }
        }
    }
    let highest = |lanes: &[f32]| lanes.iter().copied().fold(0.0, f32::max);
    Maxima { diffuse: highest(&top[..SPECULAR]), specular: highest(&top[SPECULAR..ROUGHNESS]), roughness: top[ROUGHNESS] }
}

#[cfg(test)]
mod resampling;
#[cfg(test)]
mod tests;
