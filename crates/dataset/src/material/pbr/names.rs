//! Which file of a folder holds which map, by the names that material libraries give them.

use std::path::{Path, PathBuf};

use crate::material::error::MaterialError;
use crate::material::files::is_hidden;
use crate::material::split::is_size;

const EXTENSIONS: &[&str] = &["png", "exr", "jpg", "jpeg"];

/// A map that a file may hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MapKind {
    /// Base colour, albedo or diffuse colour.
    Base,
    /// Normal map, green up (OpenGL); plain `normal` is taken as this.
    NormalUp,
    /// Normal map, green down (DirectX).
    NormalDown,
    /// Roughness.
    Roughness,
    /// Gloss or smoothness: 1 − roughness.
    Gloss,
    /// Metalness.
    Metalness,
    /// Specular colour (reflectance at normal incidence, sRGB).
    Specular,
    /// Specular level: a grey share of 0.08.
    SpecularLevel,
    /// Occlusion, roughness and metalness in red, green and blue.
    Packed,
}

/// Endings of file names, as lower-case words joined by `_`. Longer ones come first.
const NAMES: &[(MapKind, &[&str])] = &[
    (MapKind::NormalDown, &["normal_dx", "normaldx", "nor_dx", "nrm_dx", "normal_directx", "normals_dx", "norm_dx"]),
    (
        MapKind::NormalUp,
        &[
            "normal_gl",
            "normalgl",
            "nor_gl",
            "nrm_gl",
            "normal_ogl",
            "normal_opengl",
            "normals_gl",
            "norm_gl",
            "normal",
            "normals",
            "norm",
            "nrm",
            "nor",
        ],
    ),
    (MapKind::Roughness, &["roughness", "rough", "rgh"]),
    (MapKind::Gloss, &["gloss", "glossiness", "smoothness"]),
    (MapKind::Metalness, &["metalness", "metallic", "metallness", "metal", "met"]),
    (MapKind::Specular, &["specular"]),
    (MapKind::SpecularLevel, &["spec"]),
    (MapKind::Packed, &["arm", "orm"]),
    (
        MapKind::Base,
        &["base_color", "base_colour", "basecolor", "basecolour", "color", "colour", "albedo", "diffuse", "diff", "col"],
    ),
];
/// The base colours that hold no metal's colour: what goes with a specular map, in folders that have both.
const DIFFUSE: &[&str] = &["diffuse", "diff"];

/// A single-channel map: a file and the channel to read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ChannelFile {
    /// The file.
    pub path: PathBuf,
    /// 0 unless the file packs several maps.
    pub channel: usize,
}

/// The files of one material.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SetFiles {
    /// Base colour.
    pub base: PathBuf,
    /// Normal map.
    pub normal: PathBuf,
    /// Whether its green points down (DirectX).
    pub normal_down: bool,
    /// Roughness or gloss.
    pub roughness: ChannelFile,
    /// Whether the file above holds gloss.
    pub gloss: bool,
    /// Metalness, where there is a map.
    pub metalness: Option<ChannelFile>,
    /// Specular map, and whether it is a grey level.
    pub specular: Option<(PathBuf, bool)>,
}

struct Found {
    kind: MapKind,
    /// The name in the list that fits.
    name: &'static str,
    /// Its position there: earlier ones say more.
    rank: usize,
    /// The file's name before the map's.
    prefix: String,
    path: PathBuf,
}

impl SetFiles {
    /// Finds the maps in a folder.
    ///
    /// # Errors
    /// [`MaterialError::MissingMap`] with the names that were tried, [`MaterialError::Folder`] when the folder can't be read.
    pub fn find(folder: &Path) -> Result<Self, MaterialError> {
        Self::among(folder, &image_files(folder).map_err(|source| MaterialError::Folder { path: folder.into(), source })?)
    }

    /// Finds the maps among the image files of a folder; only their names count.
    ///
    /// # Errors
    /// [`MaterialError::MissingMap`] with the names that were tried.
    pub fn among(folder: &Path, files: &[PathBuf]) -> Result<Self, MaterialError> {
        let mut found: Vec<Found> = files.iter().filter_map(|path| classify(path)).collect();
        found.sort_by(|a, b| (a.rank, extension_rank(&a.path), &a.path).cmp(&(b.rank, extension_rank(&b.path), &b.path)));
        let base = found.iter().find(|f| f.kind == MapKind::Base).ok_or_else(|| missing(folder, MapKind::Base))?;
        // Maps of the base colour's prefix first: a folder may hold a preview that is named like a map.
        let pick = |kind| {
            let of_kind = || found.iter().filter(move |f| f.kind == kind);
            of_kind().find(|f| f.prefix == base.prefix).or_else(|| of_kind().next())
        };
        let same = |kind| pick(kind).filter(|f| f.prefix == base.prefix).map(|f| f.path.clone());
        let (normal, normal_down) = match (pick(MapKind::NormalUp), pick(MapKind::NormalDown)) {
            (Some(up), _) => (up.path.clone(), false),
            (None, Some(down)) => (down.path.clone(), true),
            (None, None) => return Err(missing(folder, MapKind::NormalUp)),
        };
        let packed = same(MapKind::Packed);
        let channel = |path: &PathBuf, channel| ChannelFile { path: path.clone(), channel };
        let (roughness, gloss) = match (pick(MapKind::Roughness), pick(MapKind::Gloss), &packed) {
            (Some(file), _, _) => (channel(&file.path, 0), false),
            (None, Some(file), _) => (channel(&file.path, 0), true),
            (None, None, Some(path)) => (channel(path, 1), false),
            (None, None, None) => return Err(missing(folder, MapKind::Roughness)),
        };
        // A `metal` or `arm` that isn't named like the base colour is a word of the material's name.
        let metalness = same(MapKind::Metalness).map(|p| channel(&p, 0)).or_else(|| packed.as_ref().map(|p| channel(p, 2)));
        let specular = same(MapKind::Specular).map(|p| (p, false)).or_else(|| same(MapKind::SpecularLevel).map(|p| (p, true)));
        let is_diffuse = |f: &&Found| f.kind == MapKind::Base && f.prefix == base.prefix && DIFFUSE.contains(&f.name);
        let base = match (&metalness, &specular) {
            (None, Some(_)) => found.iter().find(is_diffuse).unwrap_or(base),
            _ => base,
        };
        Ok(Self { base: base.path.clone(), normal, normal_down, roughness, gloss, metalness, specular })
    }
}

/// The images of a folder, sorted.
pub(super) fn image_files(folder: &Path) -> std::io::Result<Vec<PathBuf>> {
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder)? {
        let path = entry?.path();
        if path.is_file() && extension_rank(&path) < EXTENSIONS.len() && !is_hidden(&path) {
            files.push(path);
        }
    }
    files.sort();
    Ok(files)
}

fn extension_rank(path: &Path) -> usize {
    let extension = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
    EXTENSIONS.iter().position(|e| *e == extension).unwrap_or(EXTENSIONS.len())
}

/// Whether a folder's file is named like a map.
pub(super) fn is_map(path: &Path) -> bool {
    classify(path).is_some()
}

/// What a file holds, by the end of its name.
fn classify(path: &Path) -> Option<Found> {
    let words = words_of(&path.file_stem()?.to_string_lossy());
    let is_noise = |word: &str| is_size(word) || EXTENSIONS.contains(&word) || word.bytes().all(|b| b.is_ascii_digit());
    let end = words.iter().rposition(|w| !is_noise(w))? + 1;
    for (kind, names) in NAMES {
        for (rank, &name) in names.iter().enumerate() {
            let length = name.split('_').count();
            if end >= length && name.split('_').eq(&words[end - length..end]) {
                let prefix = words[..end - length].iter().filter(|w| !is_size(w) && !EXTENSIONS.contains(&w.as_str()));
                let prefix = prefix.cloned().collect::<Vec<_>>().join("_");
                return Some(Found { kind: *kind, name, rank, prefix, path: path.into() });
            }
        }
    }
    None
}

/// Lower-case words of a name; `BaseColor` stays one word because the list holds it as one.
fn words_of(stem: &str) -> Vec<String> {
    stem.to_lowercase().split(|c: char| !c.is_alphanumeric()).filter(|w| !w.is_empty()).map(str::to_owned).collect()
}

/// The error for a map that isn't there, with the names that would have been taken.
pub(super) fn missing(folder: &Path, kind: MapKind) -> MaterialError {
    let kinds: &[MapKind] = match kind {
        MapKind::NormalUp | MapKind::NormalDown => &[MapKind::NormalUp, MapKind::NormalDown],
        MapKind::Roughness | MapKind::Gloss => &[MapKind::Roughness, MapKind::Gloss, MapKind::Packed],
        MapKind::Metalness => &[MapKind::Metalness, MapKind::Packed],
        MapKind::Base => &[MapKind::Base],
        MapKind::Specular | MapKind::SpecularLevel => &[MapKind::Specular, MapKind::SpecularLevel],
        MapKind::Packed => &[MapKind::Packed],
    };
    let names = NAMES.iter().filter(|(k, _)| kinds.contains(k)).flat_map(|(_, names)| names.iter());
    let tried = format!("*{} with .{}", names.copied().collect::<Vec<_>>().join(", *"), EXTENSIONS.join(", ."));
    let map = match kind {
        MapKind::Base => "base colour",
        MapKind::NormalUp | MapKind::NormalDown => "normal",
        MapKind::Roughness | MapKind::Gloss => "roughness",
        MapKind::Metalness => "metalness",
        MapKind::Specular | MapKind::SpecularLevel => "specular",
        MapKind::Packed => "packed",
    };
    MaterialError::MissingMap { folder: folder.into(), map, tried }
}
