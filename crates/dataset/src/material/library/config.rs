//! What a config file says about the sources of materials.

use std::path::PathBuf;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::LibraryError;
use crate::material::four_maps::AlbedoEncoding;
use crate::material::procedural::Family;
use crate::material::stored::{GRID, Wrap};

/// One source of materials; a run may mix several.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "type", rename_all = "lowercase")]
pub enum SourceConfig {
    /// Generated materials: no file needed.
    Procedural(ProceduralConfig),
    /// Folders of texture maps.
    Pbr(PbrConfig),
    /// PNG strips of four maps.
    Inria(InriaConfig),
    /// NumPy arrays of four maps.
    Npy(NpyConfig),
}

/// Generated materials.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ProceduralConfig {
    /// Texels per side of a tile, which covers 0.5 × 0.5 of the material's 2 × 2 whatever its size.
    #[schemars(extend("unit" = "texels"))]
    pub size: usize,
    /// How many materials, over both sides of the split.
    pub count: usize,
    /// Names of the families to take; empty takes all.
    pub families: Vec<String>,
    /// Other seeds give other materials.
    pub seed: u64,
    /// How often this source is drawn, relative to the others.
    pub weight: f64,
}

impl Default for ProceduralConfig {
    fn default() -> Self {
        Self { size: 1024, count: 400, families: Vec::new(), seed: 0, weight: 1.0 }
    }
}

impl ProceduralConfig {
    /// The families this source takes; unknown names are left out (validation reports them).
    pub(super) fn families(&self) -> Vec<Family> {
        if self.families.is_empty() {
            return Family::ALL.to_vec();
        }
        self.families.iter().filter_map(|name| Family::from_name(name)).collect()
    }
}

/// Folders of texture maps.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PbrConfig {
    /// A folder with one folder per material, or one material's folder. Relative to where the program is started.
    pub path: PathBuf,
    /// Texels of the maps over the material's \[−1, 1\]: 4096 shows maps of 1024² as tiles of 0.5 × 0.5.
    #[serde(default = "grid")]
    #[schemars(extend("unit" = "texels"))]
    pub texels: usize,
    /// How maps continue beyond their edge: `repeat` for tileable ones, `mirror` for others.
    #[serde(default)]
    pub wrap: Wrap,
    /// How often this source is drawn, relative to the others.
    #[serde(default = "one")]
    pub weight: f64,
}

/// PNG strips: normal | diffuse | roughness | specular, each H×H ([`crate::material::inria`]).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct InriaConfig {
    /// A folder of strips, a `.txt` list of them, or one strip. Relative to where the program is started.
    pub path: PathBuf,
    /// How the strips store albedos: `gamma` or `linear`. There is no default, because versions of the set differ.
    pub albedo_encoding: AlbedoEncoding,
    /// Texels of the maps over the material's \[−1, 1\]: 4096 shows strips of 512² as in the paper (Fig. 2).
    #[serde(default = "grid")]
    #[schemars(extend("unit" = "texels"))]
    pub texels: usize,
    /// How maps continue beyond their edge; `mirror` shows no seam, whether they tile or not.
    #[serde(default = "mirror")]
    pub wrap: Wrap,
    /// How often this source is drawn, relative to the others.
    #[serde(default = "one")]
    pub weight: f64,
}

/// NumPy arrays of uint8, H×W×12: normal, diffuse, roughness, specular ([`crate::material::npy`]).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct NpyConfig {
    /// A folder of arrays, a `.txt` list of them, or one array. Relative to where the program is started.
    pub path: PathBuf,
    /// How the arrays store albedos: `gamma` or `linear`. There is no default: they were made from sets that differ in it.
    pub albedo_encoding: AlbedoEncoding,
    /// Whether the roughness is the square of the stored one. There is no default: the authors square that of their 4096²
    /// arrays and not that of their 1024² ones.
    pub roughness_squared: bool,
    /// Texels of the maps over the material's \[−1, 1\].
    #[serde(default = "grid")]
    #[schemars(extend("unit" = "texels"))]
    pub texels: usize,
    /// How maps continue beyond their edge; `mirror` shows no seam, whether they tile or not.
    #[serde(default = "mirror")]
    pub wrap: Wrap,
    /// How often this source is drawn, relative to the others.
    #[serde(default = "one")]
    pub weight: f64,
}

fn grid() -> usize {
    GRID
}

fn mirror() -> Wrap {
    Wrap::Mirror
}

fn one() -> f64 {
    1.0
}

impl SourceConfig {
    /// How often the source is drawn, relative to the others.
    pub fn weight(&self) -> f64 {
        match self {
            Self::Procedural(config) => config.weight,
            Self::Pbr(config) => config.weight,
            Self::Inria(config) => config.weight,
            Self::Npy(config) => config.weight,
        }
    }

    /// Checks every value; `source_index` is the position of the source (from 1) for the message.
    ///
    /// # Errors
    /// [`LibraryError::Config`] for the first value out of range.
    pub fn validate(&self, source_index: usize) -> Result<(), LibraryError> {
        let kind = match self {
            Self::Procedural(_) => "procedural",
            Self::Pbr(_) => "pbr",
            Self::Inria(_) => "inria",
            Self::Npy(_) => "npy",
        };
        let fail = |key, found: String, expected: &str| {
            Err(LibraryError::Config { source_index, kind, key, found, expected: expected.into() })
        };
        let weight = self.weight();
        if !(weight > 0.0 && weight.is_finite()) {
            return fail("weight", weight.to_string(), "a positive number");
        }
        let check_texels = |texels: usize| match texels {
            16..=65_536 => Ok(()),
            _ => fail("texels", texels.to_string(), "16 to 65536 texels over the material"),
        };
        match self {
            Self::Procedural(config) => {
                if !(64..=4096).contains(&config.size) {
                    return fail("size", config.size.to_string(), "64 to 4096 texels");
                }
                if config.count == 0 {
                    return fail("count", "0".into(), "at least 1");
                }
                if config.seed > u64::from(u32::MAX) {
                    return fail("seed", config.seed.to_string(), "0 to 4294967295");
                }
                if let Some(name) = config.families.iter().find(|name| Family::from_name(name).is_none()) {
                    let known: Vec<_> = Family::ALL.iter().map(|f| f.name()).collect();
                    return fail("families", format!("`{name}`"), &format!("names among {}", known.join(", ")));
                }
            }
            Self::Pbr(config) => {
                check_texels(config.texels)?;
                if !config.path.is_dir() {
                    return fail("path", config.path.display().to_string(), "an existing folder of material folders");
                }
            }
            Self::Inria(InriaConfig { path, texels, .. }) | Self::Npy(NpyConfig { path, texels, .. }) => {
                check_texels(*texels)?;
                if !path.exists() {
                    let expected = "an existing folder of such files, a .txt list of them, or one file";
                    return fail("path", path.display().to_string(), expected);
                }
            }
        }
        Ok(())
    }
}
