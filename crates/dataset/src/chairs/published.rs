//! The published FlyingChairs format: folders of `NAME_img1.ppm`, `NAME_img2.ppm` and `NAME_flow.flo`.

use std::path::{Path, PathBuf};

use ops::planes::{Mask, Planes};

use super::flo::{self, FloError};
use super::ppm;
use crate::pair::FlowPair;

const FIRST: &str = "_img1.ppm";
const SECOND: &str = "_img2.ppm";
const FLOW: &str = "_flow.flo";

/// A folder of pairs that can't be used.
#[derive(Debug, thiserror::Error)]
pub enum PublishedError {
    /// The file system refused.
    #[error("{path}: {source}; check that it exists and may be read", path = path.display())]
    Io {
        /// File or folder.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// A folder without pairs.
    #[error("{folder}: no file ends in {FIRST}; expected the `data` folder of FlyingChairs (NAME{FIRST}, NAME{SECOND}, NAME{FLOW})", folder = folder.display())]
    Empty {
        /// The folder.
        folder: PathBuf,
    },
    /// A pair that lacks a file.
    #[error("{missing} is missing, though {present} exists; download the pair again or remove it", missing = missing.display(), present = present.display())]
    Incomplete {
        /// What isn't there.
        missing: PathBuf,
        /// What is.
        present: PathBuf,
    },
    /// An image that can't be read.
    #[error("{path}: {found}; expected a binary PPM (P6) with 8 bits", path = path.display())]
    Image {
        /// The file.
        path: PathBuf,
        /// What was found.
        found: String,
    },
    /// A flow that can't be read.
    #[error(transparent)]
    Flow(#[from] FloError),
    /// Files of different sizes.
    #[error("{path}: {found:?} pixels (height, width), but the first image has {expected:?}", path = path.display())]
    Size {
        /// The file that differs.
        path: PathBuf,
        /// Its height and width.
        found: (usize, usize),
        /// Those of the first image.
        expected: (usize, usize),
    },
}

/// The pairs of a folder, in the order of their names.
#[derive(Clone, Debug)]
pub struct Published {
    /// Path and name of each pair, without the endings.
    stems: Vec<PathBuf>,
}

impl Published {
    /// Lists the pairs of a folder and checks that none lacks a file; images are read when they are asked for.
    ///
    /// # Errors
    /// [`PublishedError`] names the folder or the missing file.
    pub fn open(folder: &Path) -> Result<Self, PublishedError> {
        let io = |source| PublishedError::Io { path: folder.to_owned(), source };
        let mut stems = Vec::new();
        for entry in std::fs::read_dir(folder).map_err(io)? {
            let name = entry.map_err(io)?.file_name();
            if let Some(stem) = name.to_str().and_then(|n| n.strip_suffix(FIRST)) {
                stems.push(folder.join(stem));
            }
        }
        stems.sort();
        for stem in &stems {
            for ending in [SECOND, FLOW] {
                let missing = with_ending(stem, ending);
                if !missing.is_file() {
                    return Err(PublishedError::Incomplete { missing, present: with_ending(stem, FIRST) });
                }
            }
        }
        if stems.is_empty() { Err(PublishedError::Empty { folder: folder.to_owned() }) } else { Ok(Self { stems }) }
    }

    /// Number of pairs.
    pub fn len(&self) -> usize {
        self.stems.len()
    }

    /// Never true: a folder without pairs isn't opened.
    pub fn is_empty(&self) -> bool {
        self.stems.is_empty()
    }

    /// Reads a pair. Pixels are valid where the flow is known and stays inside the second image; the format doesn't tell
    /// which are hidden there.
    ///
    /// # Errors
    /// [`PublishedError`] names the file.
    ///
    /// # Panics
    /// If there is no pair `index`.
    pub fn pair(&self, index: usize) -> Result<FlowPair, PublishedError> {
        let stem = &self.stems[index];
        let first = image(&with_ending(stem, FIRST))?;
        let size = (first.height, first.width);
        let checked = |path: PathBuf, planes: Planes| {
            let found = (planes.height, planes.width);
            if found == size { Ok(planes) } else { Err(PublishedError::Size { path, found, expected: size }) }
        };
        let second = image(&with_ending(stem, SECOND))?;
        let second = checked(with_ending(stem, SECOND), second)?;
        let flow = checked(with_ending(stem, FLOW), flo::read(&with_ending(stem, FLOW))?)?;
        let valid = Mask::from_fn(size.0, size.1, |y, x| {
            let inside = |v: f32, side: usize| v >= 0.0 && v <= (side - 1) as f32;
            inside(x as f32 + flow.at(0, y, x), size.1) && inside(y as f32 + flow.at(1, y, x), size.0)
        });
        Ok(FlowPair { first, second, flow, valid })
    }
}

fn with_ending(stem: &Path, ending: &str) -> PathBuf {
    let mut path = stem.as_os_str().to_owned();
    path.push(ending);
    path.into()
}

fn image(path: &Path) -> Result<Planes, PublishedError> {
    let bytes = std::fs::read(path).map_err(|source| PublishedError::Io { path: path.to_owned(), source })?;
    ppm::parse(&bytes).map_err(|found| PublishedError::Image { path: path.to_owned(), found })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image_io::Overwrite;

    fn write_pair(folder: &Path, name: &str) {
        for ending in [FIRST, SECOND] {
            let mut bytes = b"P6 4 2 255\n".to_vec();
            bytes.extend((0..24).map(|i| i * 10));
            std::fs::write(folder.join(format!("{name}{ending}")), bytes).unwrap();
        }
        let mut flow = Planes::constant(2, 4, &[1.0, 0.0]);
        flow.set(0, 0, 0, f32::NAN);
        flo::write(&folder.join(format!("{name}{FLOW}")), &flow, Overwrite::Refuse).unwrap();
    }

    #[test]
    fn pairs_come_in_order_with_their_validity() {
        let folder = tempfile::tempdir().unwrap();
        write_pair(folder.path(), "00002");
        write_pair(folder.path(), "00001");
        let set = Published::open(folder.path()).unwrap();
        assert_eq!(set.stems, ["00001", "00002"].map(|name| folder.path().join(name)));
        let pair = set.pair(0).unwrap();
        assert_eq!((pair.first.width, pair.flow.channels, set.len()), (4, 2, 2));
        let expected = [false, true, true, false, true, true, true, false];
        assert_eq!(pair.valid.data, expected, "unknown and leaving pixels are invalid");
    }

    #[test]
    fn broken_folders_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let refused = || Published::open(folder.path()).map(|_| ()).unwrap_err().to_string();
        assert!(refused().contains("no file ends in _img1.ppm"));
        write_pair(folder.path(), "7");
        std::fs::remove_file(folder.path().join("7_flow.flo")).unwrap();
        assert!(refused().contains("7_flow.flo is missing"));
        flo::write(&folder.path().join("7_flow.flo"), &Planes::new(2, 3, 3), Overwrite::Refuse).unwrap();
        let size = Published::open(folder.path()).unwrap().pair(0).unwrap_err().to_string();
        assert!(size.contains("(3, 3)") && size.contains("(2, 4)"), "{size}");
        std::fs::write(folder.path().join("7_img2.ppm"), b"P6 4 2").unwrap();
        assert!(Published::open(folder.path()).unwrap().pair(0).unwrap_err().to_string().contains("7_img2.ppm"));
        assert!(Published::open(Path::new("no/such/folder")).unwrap_err().to_string().contains("no/such/folder"));
    }
}
