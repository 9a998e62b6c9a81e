//! What can be wrong with a material.

use std::path::PathBuf;

use crate::image_io::ImageError;

/// A material that can't be used, and why.
#[derive(Debug, thiserror::Error)]
pub enum MaterialError {
    /// A tile without texels, or with too many.
    #[error(
        "material {name}: {width}×{height} texels; expected 1×1 to 16384×16384 and a positive number of texels over the material"
    )]
    Size {
        /// Name of the material.
        name: String,
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
    },
    /// NaN or infinity in a map.
    #[error("material {name}: a map holds NaN or infinite values; export it again without them")]
    NonFinite {
        /// Name of the material.
        name: String,
    },
    /// A map that can't be derived from the others.
    #[error("{folder}: no {map} map; looked for {tried} (any case, any prefix, sizes like _2K ignored)")]
    MissingMap {
        /// The folder.
        folder: PathBuf,
        /// Which map.
        map: &'static str,
        /// The names that would have been taken.
        tried: String,
    },
    /// Maps that can't belong to one surface.
    #[error(
        "{path}: {}×{} pixels, but {base} has {}×{}: the maps of a material need the same shape",
        size[0], size[1], base_size[0], base_size[1]
    )]
    Aspect {
        /// The map.
        path: PathBuf,
        /// Its columns and rows.
        size: [usize; 2],
        /// The base colour.
        base: PathBuf,
        /// Its columns and rows.
        base_size: [usize; 2],
    },
    /// A height or bump map in the normal map's place.
    #[error("{path}: a grey image can't be a normal map; expected red, green and blue")]
    GreyNormal {
        /// The file.
        path: PathBuf,
    },
    /// A map that can't be read.
    #[error(transparent)]
    Image(#[from] ImageError),
    /// A folder that can't be read.
    #[error("{path}: can't list the material folder: {source}")]
    Folder {
        /// The folder.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// A folder without materials.
    #[error("{path}: no material in it; expected one folder per material with base colour, normal and roughness maps")]
    NoMaterials {
        /// The folder.
        path: PathBuf,
    },
    /// A source of one file per material that names none.
    #[error("{path}: no material in it; expected .{extension} files that lie in it, or a .txt list of such files")]
    NoFiles {
        /// The folder or list.
        path: PathBuf,
        /// What material files end in.
        extension: &'static str,
    },
    /// A picture that isn't a strip of four maps.
    #[error(
        "{path}: {found}; expected a PNG of 8 or 16 bit with normal, diffuse, roughness and specular side by side: four \
         colour squares, 4·H×H pixels. Leave other pictures out of the folder, or list the strips in a .txt file"
    )]
    Strip {
        /// The file.
        path: PathBuf,
        /// What was found.
        found: String,
    },
    /// An array that isn't a material.
    #[error(
        "{path}: {found}; expected uint8 numbers of shape (height, width, 12) in C order: normal, diffuse, roughness, \
         specular. Write it with numpy.save(path, numpy.ascontiguousarray(maps, numpy.uint8))"
    )]
    Npy {
        /// The file.
        path: PathBuf,
        /// What was found.
        found: String,
    },
    /// A file that the system refuses.
    #[error("{path}: can't be read: {source}; check that it exists and may be read")]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// A line of a manifest or list that can't be understood.
    #[error("{path}, line {line}: {reason}")]
    Line {
        /// The file.
        path: PathBuf,
        /// Line, from 1.
        line: usize,
        /// What is wrong.
        reason: String,
    },
}
