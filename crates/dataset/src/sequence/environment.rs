//! Environments from files: lat-long EXR and Radiance HDR pictures.

use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};

use rand::{Rng, RngExt};
use render::environment::{Environment, EnvironmentError};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::image_io::{ImageError, Picture, Samples};

/// Rows that are kept of a picture. A handful of lights stand for the whole of it, so more would show nowhere.
const ROWS: usize = 64;

/// A file of a config, or a folder of files; read once, at the first use, for all clones.
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(from = "PathBuf", into = "PathBuf")]
pub struct EnvironmentMaps {
    path: PathBuf,
    maps: Arc<OnceLock<Vec<Environment>>>,
}

/// Why environments can't be had.
#[derive(Debug, thiserror::Error)]
pub enum EnvironmentMapsError {
    /// Neither file nor folder, or it can't be listed.
    #[error("light.environments is {path}: {source}; expected a lat-long .exr or .hdr file, or a folder of such")]
    Open {
        /// The path.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// A folder without environments.
    #[error("light.environments is {0}: no .exr or .hdr file in it")]
    None(PathBuf),
    /// A picture that can't be read.
    #[error("light.environments: {0}")]
    Image(#[from] ImageError),
    /// A picture of another kind.
    #[error(
        "light.environments: {path} is {found}; expected linear light (EXR or HDR) twice as wide as high, the whole sphere \
         by longitude and latitude"
    )]
    Kind {
        /// The file.
        path: PathBuf,
        /// What it is.
        found: String,
    },
    /// Values that are no light.
    #[error("light.environments: {path}: {source}")]
    Values {
        /// The file.
        path: PathBuf,
        /// What is wrong with them.
        source: EnvironmentError,
    },
}

impl From<PathBuf> for EnvironmentMaps {
    fn from(path: PathBuf) -> Self {
        Self { path, maps: Arc::default() }
    }
}

impl From<EnvironmentMaps> for PathBuf {
    fn from(maps: EnvironmentMaps) -> Self {
        maps.path
    }
}

impl PartialEq for EnvironmentMaps {
    fn eq(&self, other: &Self) -> bool {
        self.path == other.path
    }
}

impl EnvironmentMaps {
    /// The environments, in the order of their file names; none when there is no path.
    ///
    /// # Errors
    /// [`EnvironmentMapsError`].
    pub fn load(&self) -> Result<&[Environment], EnvironmentMapsError> {
        if self.path.as_os_str().is_empty() {
            return Ok(&[]);
        }
        if let Some(maps) = self.maps.get() {
            return Ok(maps);
        }
        let maps = files(&self.path)?.iter().map(|path| read(path)).collect::<Result<_, _>>()?;
        Ok(self.maps.get_or_init(|| maps))
    }

    /// A random environment, turned at random; `None` when there is no path.
    ///
    /// # Panics
    /// If the files can't be read.
    pub(super) fn draw(&self, rng: &mut impl Rng) -> Option<Environment> {
        let maps = self.load().unwrap_or_else(|error| panic!("a config is validated before its use: {error}"));
        if maps.is_empty() {
            return None;
        }
        let environment = maps[rng.random_range(0..maps.len())].clone();
        Some(environment.turned(rng.random_range(0.0..1.0)))
    }
}

/// The file itself, or the EXR and HDR files of a folder.
fn files(path: &Path) -> Result<Vec<PathBuf>, EnvironmentMapsError> {
    let failed = |source| EnvironmentMapsError::Open { path: path.into(), source };
    if !std::fs::metadata(path).map_err(failed)?.is_dir() {
        return Ok(vec![path.into()]);
    }
    let entries = std::fs::read_dir(path).map_err(failed)?.collect::<Result<Vec<_>, _>>().map_err(failed)?;
    let known = |path: &PathBuf| {
        path.extension().is_some_and(|kind| ["exr", "hdr"].iter().any(|known| kind.eq_ignore_ascii_case(known)))
    };
    let mut files: Vec<PathBuf> = entries.into_iter().map(|entry| entry.path()).filter(known).collect();
    files.sort();
    if files.is_empty() { Err(EnvironmentMapsError::None(path.into())) } else { Ok(files) }
}

fn read(path: &Path) -> Result<Environment, EnvironmentMapsError> {
    let picture = Picture::read(path)?;
    let wrong = |found: String| EnvironmentMapsError::Kind { path: path.into(), found };
    if !matches!(picture.samples, Samples::Linear(_)) {
        return Err(wrong("a picture of encoded integers".into()));
    }
    if picture.width != 2 * picture.height {
        return Err(wrong(format!("{}×{} pixels", picture.width, picture.height)));
    }
    let rows = picture.height.min(ROWS);
    let small = picture.resized(2 * rows, rows);
    let radiance = (0..rows * 2 * rows).map(|i| std::array::from_fn(|c| small.value(c, i % (2 * rows), i / (2 * rows))));
    let environment = Environment::new(rows, 2 * rows, radiance.collect());
    environment.map_err(|source| EnvironmentMapsError::Values { path: path.into(), source })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image_io::{Overwrite, write_exr};
    use ops::planes::Planes;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    /// Black but for a sun of the given value at a row and column.
    fn sun(rows: usize, [row, column]: [usize; 2], value: f32) -> Planes {
        let mut picture = Planes::new(3, rows, 2 * rows);
        (0..3).for_each(|c| picture.set(c, row, column, value));
        picture
    }

    /// A Radiance HDR file without run lengths: every pixel as mantissas and a common exponent.
    fn hdr(rows: usize) -> Vec<u8> {
        let mut bytes = format!("#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y {rows} +X {}\n", 2 * rows).into_bytes();
        bytes.extend((0..rows * 2 * rows).flat_map(|_| [64u8, 128, 32, 129])); // (0.5, 1, 0.25)
        bytes
    }

    fn maps(path: &Path) -> EnvironmentMaps {
        path.to_path_buf().into()
    }

    #[test]
    fn pictures_keep_their_light_and_their_order() {
        let folder = tempfile::tempdir().unwrap();
        write_exr(&folder.path().join("b.exr"), &sun(128, [20, 5], 8.0), Overwrite::Refuse).unwrap();
        std::fs::write(folder.path().join("a.HDR"), hdr(4)).unwrap();
        std::fs::write(folder.path().join("licence.txt"), "CC0").unwrap();
        let environments = maps(folder.path());
        let loaded = environments.load().unwrap();
        assert_eq!(loaded.len(), 2);
        let even = loaded[0].irradiance();
        assert!((even[0] / even[1] - 0.5).abs() < 0.01 && (even[2] / even[1] - 0.25).abs() < 0.01, "{even:?}");
        // The mean of 2 × 2 pixels: 64 rows are kept, and the light stays.
        let whole =
            Environment::new(128, 256, (0..128 * 256).map(|i| [if i == 20 * 256 + 5 { 8.0 } else { 0.0 }; 3]).collect());
        let (kept, whole) = (loaded[1].irradiance()[0], whole.unwrap().irradiance()[0]);
        assert!((kept / whole - 1.0).abs() < 0.02, "{kept} {whole}");
        let drawn = |seed| environments.draw(&mut ChaCha8Rng::seed_from_u64(seed)).unwrap();
        assert_eq!(drawn(1), drawn(1));
        assert!((2..9).any(|seed| drawn(seed) != drawn(1)));
        assert!(EnvironmentMaps::default().draw(&mut ChaCha8Rng::seed_from_u64(1)).is_none());
    }

    #[test]
    fn what_is_no_environment_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let refused = |path: &Path| maps(path).load().unwrap_err().to_string();
        assert!(refused(&folder.path().join("none")).contains("expected a lat-long .exr or .hdr file"));
        assert!(refused(folder.path()).contains("no .exr or .hdr file"));
        let file = folder.path().join("x.exr");
        write_exr(&file, &Planes::constant(4, 4, &[1.0; 3]), Overwrite::Refuse).unwrap();
        assert!(refused(&file).contains("4×4 pixels"));
        write_exr(&file, &sun(4, [1, 1], -1.0), Overwrite::Allow).unwrap();
        assert!(refused(&file).contains("row 1, column 1"));
        crate::image_io::write_png8(&file, &Planes::constant(4, 8, &[1.0; 3]), Overwrite::Allow).unwrap();
        assert!(refused(&file).contains("encoded integers"));
        std::fs::write(&file, "#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 8000 +X 16000\n").unwrap();
        assert!(refused(&file).contains("truncated"), "{}", refused(&file));
        let whole = hdr(4);
        for cut in [12, 40, whole.len() - 1] {
            std::fs::write(&file, &whole[..cut]).unwrap();
            assert!(refused(&file).contains("x.exr"), "{}", refused(&file));
        }
    }
}
