//! Materials made by functions of a seed: the embedded source that needs no file.
//!
//! A family is a recipe (bricks, denim, chipped paint …). It draws its parameters from a seeded stream, builds ONE height
//! field and derives the normal, albedo, roughness and specular maps from it and from the layers that shaped it, so the
//! maps agree the way measured ones do. Every field is periodic, so every material tiles, and everything is a function of
//! the position in the tile, so a material looks the same at every resolution.
//!
//! # Units
//! A tile is 1024 reference texels wide whatever its size in texels; at the default of 4096 texels over [−1, 1] a tile of
//! 1024² covers 0.5 world units and a video frame sees 205 to 410 texels of it.

pub mod colour;
pub mod draw;
mod family;
pub mod field;
pub mod noise;
mod pattern;
pub mod surface;
pub mod worley;

use draw::Draw;
use family::{coated_metal, ground, hide, masonry, metal, mineral, plastic, roof, sheet, stone, textile, tile, wood};

use super::maps::MaterialMaps;

macro_rules! families {
    ($($(#[$doc:meta])* $variant:ident = $name:literal, $texture:ident, $make:path;)*) => {
        /// A kind of material. Its position in [`Family::ALL`] names its random stream, so new families go to the end.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub enum Family { $($(#[$doc])* $variant,)* }

        impl Family {
            /// Every family.
            pub const ALL: &'static [Self] = &[$(Self::$variant,)*];

            /// Its name in configs, manifests and reports.
            pub fn name(self) -> &'static str {
                match self { $(Self::$variant => $name,)* }
            }

            /// Whether a video frame of it shows texture that an aligner can hold on to, apart from the highlight.
            ///
            /// Low-texture families are even in albedo (contrast of a few per cent at every scale) and smooth: under a
            /// flash they show a moving highlight and little else. Reports give alignment figures for both classes.
            pub fn textured(self) -> bool {
                match self { $(Self::$variant => matches!(Texture::$texture, Texture::Rich),)* }
            }

            fn make(self) -> fn(&mut Draw) -> MaterialMaps {
                match self { $(Self::$variant => $make,)* }
            }
        }
    };
}

enum Texture {
    Rich,
    Low,
}

families! {
    /// Bricks in mortar.
    Bricks = "bricks", Rich, masonry::bricks;
    /// Paving blocks in a herringbone.
    Pavers = "pavers", Rich, masonry::pavers;
    /// Rounded cobbles.
    Cobbles = "cobbles", Rich, masonry::cobbles;
    /// Irregular flat stones.
    Flagstones = "flagstones", Rich, masonry::flagstones;
    /// Glazed tiles in grout.
    CeramicTiles = "ceramic_tiles", Rich, tile::ceramic_tiles;
    /// Tiles with a printed ornament.
    PrintedTiles = "printed_tiles", Rich, tile::printed_tiles;
    /// Stone chips in a polished binder.
    Terrazzo = "terrazzo", Rich, tile::terrazzo;
    /// Smooth glazed porcelain.
    Porcelain = "porcelain", Low, tile::porcelain;
    /// Sawn wood or veneer.
    WoodGrain = "wood_grain", Rich, wood::wood_grain;
    /// Boards with gaps.
    WoodPlanks = "wood_planks", Rich, wood::wood_planks;
    /// Wooden blocks in a herringbone.
    Parquet = "parquet", Rich, wood::parquet;
    /// Tree bark.
    Bark = "bark", Rich, wood::bark;
    /// Coarse woven cloth.
    WovenCloth = "woven_cloth", Rich, textile::woven_cloth;
    /// Denim.
    Denim = "denim", Rich, textile::denim;
    /// Knitwear.
    Knit = "knit", Rich, textile::knit;
    /// Loop or cut pile.
    Carpet = "carpet", Rich, textile::carpet;
    /// Leather.
    Leather = "leather", Rich, hide::leather;
    /// Paper and cardboard.
    Paper = "paper", Low, hide::paper;
    /// Brushed metal.
    BrushedMetal = "brushed_metal", Rich, metal::brushed_metal;
    /// Hammered metal.
    HammeredMetal = "hammered_metal", Rich, metal::hammered_metal;
    /// Polished or satin metal.
    PolishedMetal = "polished_metal", Low, metal::polished_metal;
    /// Chequer plate.
    DiamondPlate = "diamond_plate", Rich, metal::diamond_plate;
    /// Rusting steel.
    RustedMetal = "rusted_metal", Rich, coated_metal::rusted_metal;
    /// Chipped paint over primer over metal.
    ChippedPaint = "chipped_paint", Rich, coated_metal::chipped_paint;
    /// Intact lacquer on metal.
    LacqueredMetal = "lacquered_metal", Low, coated_metal::lacquered_metal;
    /// Smooth plaster or wall paint.
    Plaster = "plaster", Low, mineral::plaster;
    /// Rough render.
    Stucco = "stucco", Rich, mineral::stucco;
    /// Cast concrete.
    Concrete = "concrete", Rich, mineral::concrete;
    /// Natural rock.
    Rock = "rock", Rich, mineral::rock;
    /// Polished marble or onyx.
    Marble = "marble", Rich, mineral::marble;
    /// Pebbles or crushed stone.
    Gravel = "gravel", Rich, ground::gravel;
    /// Sand and earth.
    Sand = "sand", Rich, ground::sand;
    /// Leaf litter.
    Leaves = "leaves", Rich, ground::leaves;
    /// Grass.
    Grass = "grass", Rich, ground::grass;
    /// Plain, blackened or anodised sheet metal.
    SheetMetal = "sheet_metal", Low, sheet::sheet_metal;
    /// Corrugated sheet, galvanised or painted.
    CorrugatedSheet = "corrugated_sheet", Rich, sheet::corrugated_sheet;
    /// Chainmail.
    Chainmail = "chainmail", Rich, sheet::chainmail;
    /// Moulded plastic and rubber.
    Plastic = "plastic", Low, plastic::plastic;
    /// Granite.
    Granite = "granite", Rich, stone::granite;
    /// Pantiles, flat roof tiles and slates.
    RoofTiles = "roof_tiles", Rich, roof::roof_tiles;
}

impl Family {
    /// The family of a name, as [`Family::name`] gives it.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.iter().copied().find(|family| family.name() == name)
    }
}

/// The material of a family and seed on a tile of `size × size` texels.
///
/// The same arguments give the same bits, on any thread. Runs on the calling thread alone.
///
/// # Panics
/// If `size` is below 16.
pub fn generate(family: Family, seed: u64, size: usize) -> MaterialMaps {
    assert!(size >= 16, "a procedural material needs at least 16 texels, not {size}");
    family.make()(&mut Draw::new(seed, family as u64 + 1, size))
}
