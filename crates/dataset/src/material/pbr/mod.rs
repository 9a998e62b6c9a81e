//! Folders of texture maps, as ambientCG, Poly Haven, MatSynth, cgbookcase and 3DTextures publish them.
//!
//! Base colour and metalness become diffuse = base·(1 − m) and specular = 0.04·(1 − m) + base·m; a specular map instead of
//! metalness is taken as it is. Colours are decoded from sRGB unless they come from an EXR, which is linear already.

mod names;

use std::path::{Path, PathBuf};

use render::texel::Texel;

pub use names::{MapKind, SetFiles};

use super::decoding::{self, ColourTable};
use super::error::MaterialError;
use super::files::is_hidden;
use super::manifest::{Manifest, ManifestRow, Metallic};
use super::stored::{MAX_STORED_SIDE, Material, MaterialInfo, Precision, Wrap};
use crate::image_io::{Picture, Samples};

/// Reflectance at normal incidence of a material that isn't a metal (refractive index 1.5).
const DIELECTRIC_SPECULAR: f32 = 0.04;
/// What a `spec` map of 1 means in the conventions that call it the specular level (0.5 is 0.04).
const SPECULAR_LEVEL: f32 = 0.08;
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
/// [`MaterialError::Line`] for a manifest that can't be understood.
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
        if is_hidden(&folder) || !folder.is_dir() || names::image_files(&folder).map_err(fail)?.is_empty() {
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

    /// The licence that the manifest states, or that it states none.
    pub fn licence(&self) -> String {
        self.manifest.licence_or_unknown()
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
                Some(Specular { colours: srgb(&picture), picture, level: *level })
            }
            _ => None,
        };
        Ok(Self {
            colours: srgb(&base),
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
        let specular = self.specular.as_ref().map(|map| &map.picture);
        let pictures = [&self.base, &self.normal, &self.roughness.0].into_iter().chain(specular);
        decoding::precision(pictures.map(|p| &p.samples))
    }

    fn texel(&self, x: usize, y: usize) -> Texel {
        let base = colour(&self.colours, &self.base, x, y);
        let roughness = self.roughness.0.value(self.roughness.1, x, y);
        let (diffuse, specular) = match &self.specular {
            Some(map) => {
                let f0 = if map.level {
                    [SPECULAR_LEVEL * map.picture.value(0, x, y); 3]
                } else {
                    colour(&map.colours, &map.picture, x, y)
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
        let first = (y * self.normal.width + x) * self.normal.channels;
        let [nx, ny, nz] = decoding::normal(&self.normal.samples, first, self.normal_signed);
        [nx, if self.normal_down { -ny } else { ny }, nz]
    }
}

fn srgb(picture: &Picture) -> ColourTable {
    ColourTable::new(&picture.samples, ops::colour::srgb_to_linear)
}

fn colour(table: &ColourTable, picture: &Picture, x: usize, y: usize) -> [f32; 3] {
    table.rgb(&picture.samples, (y * picture.width + x) * picture.channels, picture.channels)
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

#[cfg(test)]
mod tests;
