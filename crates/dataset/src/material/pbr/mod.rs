//! Folders of texture maps, as ambientCG, Poly Haven, MatSynth, cgbookcase and 3DTextures publish them.
//!
//! Base colour and metalness become diffuse = base·(1 − m) and specular = 0.04·(1 − m) + base·m; a specular map instead of
//! metalness is taken as it is. Colours are decoded from sRGB unless they come from an EXR, which is linear already.

mod manifest;
mod names;

use std::path::{Path, PathBuf};

use render::texel::Texel;

pub use manifest::{Manifest, ManifestRow, Metallic};
pub use names::{MapKind, SetFiles};

use super::error::MaterialError;
use super::stored::{Material, MaterialInfo, Precision, Wrap};
use crate::image_io::{Picture, Samples};

/// Reflectance at normal incidence of a material that isn't a metal (refractive index 1.5).
const DIELECTRIC_SPECULAR: f32 = 0.04;
/// What a `spec` map of 1 means in the conventions that call it the specular level (0.5 is 0.04).
const SPECULAR_LEVEL: f32 = 0.08;
/// Longest side that is stored: the grid has no more texels, and the memory budget is made for it.
const MAX_STORED_SIDE: usize = 4096;
/// Aspect ratios of maps may differ by this much before they can't be maps of one surface.
const ASPECT_TOLERANCE: f64 = 0.02;

/// One folder of maps, found but not yet read.
#[derive(Clone, Debug)]
pub struct PbrFolder {
    /// The folder.
    pub path: PathBuf,
    /// Its name.
    pub name: String,
    /// Which file holds which map.
    pub files: SetFiles,
    /// What a manifest beside the folder says of it.
    pub manifest: ManifestRow,
}

/// All material folders under a path (or the path itself when it holds maps), sorted by name.
///
/// Folders without any image are passed over; so are those that the manifest marks as not used.
///
/// # Errors
/// [`MaterialError::NoMaterials`] when there is none, [`MaterialError::MissingMap`] for the first folder that lacks a map,
/// [`MaterialError::Manifest`] for a manifest that can't be understood.
pub fn find_folders(path: &Path) -> Result<Vec<PbrFolder>, MaterialError> {
    let fail = |source| MaterialError::Folder { path: path.into(), source };
    if names::image_files(path).map_err(fail)?.iter().any(|file| names::is_map(file)) {
        let manifest = Manifest::beside(path.parent().unwrap_or(path))?;
        return Ok(vec![PbrFolder::open(path, &manifest)?]);
    }
    let manifest = Manifest::beside(path)?;
    let mut folders = Vec::new();
    let mut paths: Vec<PathBuf> =
        std::fs::read_dir(path).map_err(fail)?.map(|e| e.map(|e| e.path())).collect::<Result<_, _>>().map_err(fail)?;
    paths.sort();
    for folder in paths {
        let hidden = folder.file_name().is_some_and(|n| n.to_string_lossy().starts_with('.'));
        if hidden || !folder.is_dir() || names::image_files(&folder).map_err(fail)?.is_empty() {
            continue;
        }
        let found = PbrFolder::open(&folder, &manifest)?;
        if found.manifest.used {
            folders.push(found);
        }
    }
    if folders.is_empty() {
        return Err(MaterialError::NoMaterials { path: path.into() });
    }
    Ok(folders)
}

impl PbrFolder {
    /// Finds the maps of a folder by their names.
    ///
    /// # Errors
    /// [`MaterialError::MissingMap`] when a map that can't be derived isn't there.
    pub fn open(path: &Path, manifest: &Manifest) -> Result<Self, MaterialError> {
        let canonical = path.canonicalize().unwrap_or_else(|_| path.into());
        let name = canonical.file_name().map_or_else(|| "material".into(), |n| n.to_string_lossy().into_owned());
        let manifest = manifest.row(&name);
        let files = SetFiles::find(path)?;
        if manifest.metallic == Some(Metallic::Map) && files.metalness.is_none() {
            return Err(names::missing(path, MapKind::Metalness));
        }
        Ok(Self { path: path.into(), name, files, manifest })
    }

    /// Reads and combines the maps.
    ///
    /// # Errors
    /// Unreadable files ([`MaterialError::Image`]), maps of different shapes ([`MaterialError::Aspect`]).
    pub fn load(&self, texels: usize, wrap: Wrap) -> Result<Material, MaterialError> {
        let maps = PbrMaps::read(self)?;
        let info = MaterialInfo {
            name: self.name.clone(),
            identity: self.identity(),
            source: format!("pbr {}", self.path.display()),
            licence: self.licence(),
            textured: None,
            wrap,
            texels,
        };
        Material::build(info, maps.base.width, maps.base.height, maps.precision(), |x, y| maps.texel(x, y))
    }

    /// What the split goes by.
    pub fn identity(&self) -> String {
        super::split::identity_of_scan(&self.name)
    }

    /// The licence that the manifest states.
    pub fn licence(&self) -> String {
        self.manifest.licence.clone().unwrap_or_else(|| "not stated".into())
    }
}

/// The pictures of one material, all of one size.
struct PbrMaps {
    base: Picture,
    colours: ColourTable,
    normal: Picture,
    /// Whether the normal map's green points down.
    normal_down: bool,
    /// EXR normals that are stored as −1…1 rather than 0…1.
    normal_signed: bool,
    roughness: (Picture, usize),
    gloss: bool,
    metalness: Option<(Picture, usize)>,
    metallic: f32,
    specular: Option<Specular>,
}

struct Specular {
    picture: Picture,
    colours: ColourTable,
    /// A grey level (× 0.08) instead of a colour.
    level: bool,
}

impl PbrMaps {
    fn read(folder: &PbrFolder) -> Result<Self, MaterialError> {
        let files = &folder.files;
        let mut base = Picture::read(&files.base)?;
        let longest = base.width.max(base.height);
        if longest > MAX_STORED_SIDE {
            let shrunk = |side: usize| (side * MAX_STORED_SIDE / longest).max(1);
            base = base.resized(shrunk(base.width), shrunk(base.height));
        }
        let size = [base.width, base.height];
        let read = |path: &PathBuf| read_like(path, &files.base, size);
        let normal = read(&files.normal)?;
        if normal.channels != 3 {
            return Err(MaterialError::GreyNormal { path: files.normal.clone() });
        }
        let normal_signed = matches!(&normal.samples, Samples::Linear(v) if v.iter().any(|&v| v < -0.01));
        let roughness = (read(&files.roughness.path)?, files.roughness.channel);
        let metalness = match &files.metalness {
            Some(file) => Some((read(&file.path)?, file.channel)),
            None => None,
        };
        let specular = match &files.specular {
            Some((path, level)) if metalness.is_none() => {
                let picture = read(path)?;
                Some(Specular { colours: ColourTable::of(&picture), picture, level: *level })
            }
            _ => None,
        };
        Ok(Self {
            colours: ColourTable::of(&base),
            base,
            normal,
            normal_down: files.normal_down,
            normal_signed,
            roughness,
            gloss: files.gloss,
            metalness,
            metallic: if folder.manifest.metallic == Some(Metallic::Yes) { 1.0 } else { 0.0 },
            specular,
        })
    }

    fn precision(&self) -> Precision {
        let eight = |p: &Picture| matches!(p.samples, Samples::Eight(_));
        if eight(&self.base) && eight(&self.normal) && eight(&self.roughness.0) { Precision::Eight } else { Precision::Sixteen }
    }

    fn texel(&self, x: usize, y: usize) -> Texel {
        let base = self.colours.rgb(&self.base, x, y);
        let roughness = self.roughness.0.value(self.roughness.1, x, y);
        let (diffuse, specular) = match &self.specular {
            Some(map) => {
                let f0 = if map.level {
                    [SPECULAR_LEVEL * map.picture.value(0, x, y); 3]
                } else {
                    map.colours.rgb(&map.picture, x, y)
                };
                (base, f0)
            }
            None => {
                let m = self.metalness.as_ref().map_or(self.metallic, |(p, c)| p.value(*c, x, y).clamp(0.0, 1.0));
                (base.map(|b| b * (1.0 - m)), base.map(|b| DIELECTRIC_SPECULAR * (1.0 - m) + b * m))
            }
        };
        let roughness = if self.gloss { 1.0 - roughness } else { roughness };
        Texel { normal: self.normal(x, y), diffuse, roughness, specular }
    }

    fn normal(&self, x: usize, y: usize) -> [f32; 3] {
        let stored: [f32; 3] = std::array::from_fn(|c| self.normal.value(c, x, y));
        // 128 of 255 (32768 of 65535) is what every tool writes for "flat", so it is exactly 0 here.
        let [nx, ny, nz] = match self.normal.samples {
            Samples::Eight(_) => stored.map(|v| (v * 255.0 - 128.0) / 127.0),
            Samples::Sixteen(_) => stored.map(|v| (v * 65535.0 - 32768.0) / 32767.0),
            Samples::Linear(_) if self.normal_signed => stored,
            Samples::Linear(_) => stored.map(|v| 2.0 * v - 1.0),
        };
        let ny = if self.normal_down { -ny } else { ny };
        // Two-channel normal maps leave blue empty.
        let nz = if nz > 0.0 { nz } else { (1.0 - nx * nx - ny * ny).max(0.0).sqrt() };
        [nx, ny, nz]
    }
}

fn read_like(path: &Path, base: &Path, [width, height]: [usize; 2]) -> Result<Picture, MaterialError> {
    let picture = Picture::read(path)?;
    let aspect = (picture.width * height) as f64 / (picture.height * width) as f64;
    if (aspect - 1.0).abs() > ASPECT_TOLERANCE {
        return Err(MaterialError::Aspect {
            path: path.into(),
            size: [picture.width, picture.height],
            base: base.into(),
            base_size: [width, height],
        });
    }
    Ok(picture.resized(width, height))
}

/// Linear light of every stored value, so that decoding 16 million texels takes no powers.
struct ColourTable(Vec<f32>);

impl ColourTable {
    fn of(picture: &Picture) -> Self {
        let steps = match picture.samples {
            Samples::Eight(_) => 256,
            Samples::Sixteen(_) => 65536,
            Samples::Linear(_) => 0,
        };
        Self((0..steps).map(|i| ops::colour::srgb_to_linear(i as f32 / (steps - 1) as f32)).collect())
    }

    fn rgb(&self, picture: &Picture, x: usize, y: usize) -> [f32; 3] {
        let pixel = (y * picture.width + x) * picture.channels;
        std::array::from_fn(|c| {
            let index = pixel + c.min(picture.channels - 1);
            match &picture.samples {
                Samples::Eight(v) => self.0[usize::from(v[index])],
                Samples::Sixteen(v) => self.0[usize::from(v[index])],
                Samples::Linear(v) => v[index].clamp(0.0, 1.0),
            }
        })
    }
}

#[cfg(test)]
mod tests;
