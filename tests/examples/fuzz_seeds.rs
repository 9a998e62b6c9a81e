//! Writes small valid files of every format that is fuzzed: where libFuzzer starts from.
//!
//! `cargo run -p acceptance --example fuzz_seeds -- fuzz/corpus`

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use burn::tensor::Device;
use dataset::chairs::flo;
use dataset::image_io::{Overwrite, lens, write_exr, write_png8, write_png16};
use exr::prelude::{
    AnyChannel, AnyChannels, Blocks, Compression, Encoding, FlatSamples, Image, Layer, LayerAttributes, LineOrder, Vec2,
    WritableImage,
};
use flow::pwc::PwcConfig;
use image::{DynamicImage, ImageFormat, RgbImage};
use ops::planes::Planes;
use ops::weights::{MANIFEST, Precision};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use svbrdf::net::SvbrdfNetConfig;

/// Smallest side of a clip's frames.
const FRAME: usize = dataset::capture::MIN_SIDE;

fn main() -> Result<()> {
    let corpus = PathBuf::from(std::env::args().nth(1).context("usage: fuzz_seeds FOLDER")?);
    let seeds = Seeds { corpus };
    images(&seeds)?;
    photographs(&seeds)?;
    arrays(&seeds)?;
    chairs(&seeds)?;
    weights(&seeds)?;
    checkpoints(&seeds)?;
    texts(&seeds)
}

/// The folder with one folder per target.
struct Seeds {
    corpus: PathBuf,
}

impl Seeds {
    /// Where a seed of a target lies.
    fn path(&self, target: &str, name: &str) -> Result<PathBuf> {
        let folder = self.corpus.join(target);
        fs::create_dir_all(&folder).with_context(|| format!("making {}", folder.display()))?;
        Ok(folder.join(name))
    }

    fn write(&self, target: &str, name: &str, bytes: &[u8]) -> Result<()> {
        let path = self.path(target, name)?;
        fs::write(&path, bytes).with_context(|| format!("writing {}", path.display()))
    }
}

fn ramp(channels: usize, height: usize, width: usize) -> Planes {
    let count = channels * height * width;
    Planes::from_vec(channels, height, width, (0..count).map(|i| i as f32 / (count - 1) as f32).collect())
}

fn images(seeds: &Seeds) -> Result<()> {
    for channels in [1, 3] {
        write_png8(&seeds.path("png", &format!("eight_{channels}"))?, &ramp(channels, 5, 7), Overwrite::Allow)?;
        write_png16(&seeds.path("png", &format!("sixteen_{channels}"))?, &ramp(channels, 5, 7), Overwrite::Allow)?;
        write_exr(&seeds.path("exr", &format!("floats_{channels}"))?, &ramp(channels, 5, 7), Overwrite::Allow)?;
    }
    // Two rows of eight pixels, the second as runs: (0.5, 1, 0.25) everywhere.
    let mut hdr = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 2 +X 8\n".to_vec();
    hdr.extend([64, 128, 32, 129].repeat(8));
    hdr.extend([2, 2, 0, 8, 136, 64, 136, 128, 136, 32, 136, 129]);
    seeds.write("hdr", "flat_and_runs", &hdr)?;
    let colours = RgbImage::from_fn(19, 17, |x, y| image::Rgb([(x * 9) as u8, (y * 7) as u8, 80]));
    let colours = DynamicImage::ImageRgb8(colours);
    colours.to_rgba8().save_with_format(seeds.path("png", "alpha")?, ImageFormat::Png)?;
    colours.save_with_format(seeds.path("jpeg", "colours")?, ImageFormat::Jpeg)?;
    colours.to_luma8().save_with_format(seeds.path("jpeg", "grey")?, ImageFormat::Jpeg)?;

    let compressions = [Compression::Uncompressed, Compression::RLE, Compression::ZIP1, Compression::PIZ, Compression::PXR24];
    let lossy = [Compression::B44, Compression::B44A];
    for compression in compressions.into_iter().chain(lossy) {
        for (name, blocks) in [("lines", Blocks::ScanLines), ("tiles", Blocks::Tiles(Vec2(4, 4)))] {
            let channel = |c: &str| AnyChannel::new(c, FlatSamples::F32(ramp(1, 5, 7).data));
            let channels = AnyChannels::sort(["A", "B", "G", "R"].map(channel).into_iter().collect());
            let encoding = Encoding { compression, blocks, line_order: LineOrder::Increasing };
            let layer = Layer::new((7, 5), LayerAttributes::default(), encoding, channels);
            let path = seeds.path("exr", &format!("{compression:?}_{name}").to_lowercase())?;
            Image::from_layer(layer).write().to_file(path)?;
        }
    }

    for (name, write) in [("eight", write_png8 as fn(&Path, &Planes, Overwrite) -> Result<(), _>), ("sixteen", write_png16)] {
        let path = seeds.path("inria", name)?;
        write(&path, &ramp(3, 5, 20), Overwrite::Allow)?;
        let strip = fs::read(&path)?;
        // The target's first byte says how albedos are stored.
        fs::write(&path, [&[6], &strip[..]].concat())?;
    }
    Ok(())
}

fn npy(kind: &str, shape: &str, data: &[u8]) -> Vec<u8> {
    let mut header = format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': ({shape}), }}");
    while (header.len() + 11) % 64 != 0 {
        header.push(' ');
    }
    header.push('\n');
    [b"\x93NUMPY\x01\x00", &(header.len() as u16).to_le_bytes()[..], header.as_bytes(), data].concat()
}

/// EXIF data of a lens of 26 mm (equivalent) and 5 mm, by themselves (TIFF) and in a JPEG without a picture.
fn photographs(seeds: &Seeds) -> Result<()> {
    let entry = |tag: u16, kind: u16, value: u32| {
        [&tag.to_le_bytes()[..], &kind.to_le_bytes(), &1u32.to_le_bytes(), &value.to_le_bytes()].concat()
    };
    let (short, long, rational) = (3, 4, 5);
    // The first directory points to the second, and its focal length to the two numbers at the end.
    let first = [&1u16.to_le_bytes()[..], &entry(0x8769, long, 26), &[0; 4]].concat();
    let fields = [(0x920a, rational, 80), (0xa002, long, 40), (0xa003, long, 30), (0xa405, short, 26)];
    let fields: Vec<u8> = fields.into_iter().flat_map(|(tag, kind, value)| entry(tag, kind, value)).collect();
    let second = [&4u16.to_le_bytes()[..], &fields, &[0; 4], &5000u32.to_le_bytes(), &1000u32.to_le_bytes()].concat();
    let tiff = [&b"II*\0\x08\0\0\0"[..], &first, &second].concat();
    let length = (tiff.len() as u16 + 8).to_be_bytes();
    let jpeg = [&b"\xff\xd8\xff\xe1"[..], &length, b"Exif\0\0", &tiff, b"\xff\xd9"].concat();
    for (name, bytes) in [("tiff", &tiff), ("jpeg", &jpeg)] {
        anyhow::ensure!(lens::of_bytes(bytes).is_some(), "the {name} tells no focal length");
        seeds.write("exif", name, bytes)?;
    }
    Ok(())
}

/// Arrays, behind the byte that says how the targets read them.
fn arrays(seeds: &Seeds) -> Result<()> {
    let bytes: Vec<u8> = (0..3 * 5 * 12).map(|i| (i * 7) as u8).collect();
    seeds.write("material_npy", "maps", &[&[12], &npy("|u1", "3, 5, 12", &bytes)[..]].concat())?;
    let pixels = FRAME * FRAME * 3;
    let bytes: Vec<u8> = (0..2 * pixels).map(|i| (i * 7) as u8).collect();
    let shape = format!("2, {FRAME}, {FRAME}, 3");
    seeds.write("clip_npy", "bytes", &[&[0], &npy("|u1", &shape, &bytes)[..]].concat())?;
    let floats: Vec<u8> = (0..2 * pixels).flat_map(|i| ((i % 100) as f32 / 100.0).to_le_bytes()).collect();
    seeds.write("clip_npy", "floats", &[&[1], &npy("<f4", &shape, &floats)[..]].concat())
}

fn chairs(seeds: &Seeds) -> Result<()> {
    seeds.write("ppm", "image", &[b"P6\n# a comment\n5 4\n255\n", &[200; 60][..]].concat())?;
    Ok(flo::write(&seeds.path("flo", "flow")?, &ramp(2, 4, 5), Overwrite::Allow)?)
}

/// Each net with its manifest in one input: manifest, zero byte, tensors.
fn weights(seeds: &Seeds) -> Result<()> {
    let device = Device::flex();
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let config = PwcConfig {
        channels: vec![2, 2],
        convs_per_level: 1,
        estimator: vec![2],
        radius: 1,
        context: vec![2],
        ..PwcConfig::slim()
    };
    let pwc = config.init(&device, &mut rng);
    let folder = seeds.path("weights", "scratch")?;
    let name = flow::weights::ADJACENT;
    flow::weights::save(&folder, name, &pwc, "a seed".into(), BTreeMap::new(), Precision::F16)?;
    joined(seeds, &folder, name)?;
    let net = SvbrdfNetConfig { width: 4, levels: 1, ..SvbrdfNetConfig::default() }.init(&device, &mut rng)?;
    svbrdf::weights::save(&folder, &net, "a seed".into(), BTreeMap::new(), Precision::F32)?;
    joined(seeds, &folder, svbrdf::weights::NAME)
}

/// Without the checksum: every change to the tensors would end there.
fn joined(seeds: &Seeds, folder: &Path, net: &str) -> Result<()> {
    let mut manifest: serde_json::Value = serde_json::from_slice(&fs::read(folder.join(MANIFEST))?)?;
    if let Some(record) = manifest["nets"][net].as_object_mut() {
        record.remove("sha256");
    }
    let tensors = fs::read(folder.join(format!("{net}.safetensors")))?;
    seeds.write("weights", net, &[manifest.to_string().as_bytes(), &[0], &tensors].concat())?;
    Ok(fs::remove_dir_all(folder)?)
}

/// The goldens of `train import`.
fn checkpoints(seeds: &Seeds) -> Result<()> {
    let goldens = Path::new(env!("CARGO_MANIFEST_DIR")).join("golden/flow");
    ["release", "release-first-version"].into_iter().try_for_each(|name| {
        let path = goldens.join(name).join("pwc_net.pth.tar");
        seeds.write("checkpoint", name, &fs::read(&path).with_context(|| format!("reading {}", path.display()))?)
    })
}

fn texts(seeds: &Seeds) -> Result<()> {
    let configs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../configs");
    for entry in fs::read_dir(configs)? {
        let path = entry?.path();
        let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        seeds.write("config", &name, &[&fs::read(&path)?, &b"\0svbrdf.steps=2\nrun.name=a"[..]].concat())?;
    }
    let libraries = [
        ("ambientcg", "Bricks075B_2K-PNG_Color.png\nBricks075B_2K-PNG_NormalGL.png\nBricks075B_2K-PNG_Roughness.png\n"),
        ("poly_haven", "rock_diff_4k.jpg\nrock_nor_dx_4k.exr\nrock_arm_4k.jpg\n"),
        ("gloss", "basecolor.jpg\nnormal.jpg\nGlossiness.png\nMetalness.png\n"),
        ("specular", "Tiles_col.png\nTiles_diffuse.png\nTiles_nrm.png\nTiles_rgh.png\nTiles_spec.png\n"),
        (
            "manifest",
            "name\tlicence\tmetallic\tcategory\tused\nBricks075B\tCC0-1.0\t0\tbrick\tno\n0000237;a;2X3\t\tmap\t\tyes\n",
        ),
    ];
    libraries.into_iter().try_for_each(|(name, text)| seeds.write("material_names", name, text.as_bytes()))
}
