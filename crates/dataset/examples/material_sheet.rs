//! Draws a contact sheet of the procedural materials: for each family and seed a flash-lit view at the scale of a video
//! frame and the four maps of the same window.
//!
//! `cargo run -p dataset --example material_sheet -- OUT.png [FAMILY,FAMILY…] [FIRST_SEED] [SEEDS]`

use std::time::Instant;

use dataset::material::maps::MaterialMaps;
use dataset::material::procedural::{Family, generate};
use image::{Rgb, RgbImage};
use render::brdf::BrdfModel;
use render::light::{Light, radiance};
use render::texel::Texel;

/// Texels per edge of a material.
const SIZE: usize = 1024;
/// Edge of the window that is shown: what a video frame sees, in texels.
const WINDOW: usize = 384;
/// Edge of one picture.
const TILE: usize = 192;
/// Half field of view of the pictured camera, as a tangent.
const TAN: f32 = 0.28;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let out = arguments.first().ok_or("usage: material_sheet OUT.png [FAMILY,FAMILY…] [FIRST_SEED] [SEEDS]")?;
    let families: Vec<Family> = match arguments.get(1).map(String::as_str) {
        None | Some("all") => Family::ALL.to_vec(),
        Some(names) => {
            names.split(',').map(|n| Family::from_name(n).ok_or(format!("no family {n}"))).collect::<Result<_, _>>()?
        }
    };
    let first: u64 = arguments.get(2).map_or(Ok(0), |s| s.parse())?;
    let seeds: u64 = arguments.get(3).map_or(Ok(3), |s| s.parse())?;
    let rows = families.len();
    let mut sheet = RgbImage::new((seeds as usize * 5 * TILE) as u32, (rows * TILE) as u32);
    for (row, &family) in families.iter().enumerate() {
        for k in 0..seeds {
            let start = Instant::now();
            let maps = generate(family, first + k, SIZE);
            let milliseconds = start.elapsed().as_millis();
            report(family, first + k, &maps, milliseconds);
            for picture in 0..5 {
                let x0 = (k as usize * 5 + picture) * TILE;
                paste(&mut sheet, x0, row * TILE, |x, y| pixel(&maps, picture, x, y));
            }
        }
    }
    sheet.save(out)?;
    Ok(())
}

/// One line of statistics, to compare with measured materials.
fn report(family: Family, seed: u64, maps: &MaterialMaps, milliseconds: u128) {
    let mean = |values: &[f32]| values.iter().sum::<f32>() / values.len() as f32;
    let mut tilt: Vec<f32> = maps.normal.plane(2).iter().map(|z| z.clamp(-1.0, 1.0).acos().to_degrees()).collect();
    tilt.sort_by(f32::total_cmp);
    println!(
        "{:16} {seed:3}  diffuse {:.2} specular {:.2} roughness {:.2}  tilt {:4.1} p95 {:4.1}  contrast {:.3}  {milliseconds} ms",
        family.name(),
        mean(&maps.diffuse.data),
        mean(&maps.specular.data),
        mean(&maps.roughness.data),
        mean(&tilt),
        tilt[tilt.len() * 95 / 100],
        contrast(maps),
    );
}

/// Median over blocks of 8 × 8 pixels of the flash-lit view of the standard deviation of the encoded brightness, highlight
/// and all.
fn contrast(maps: &MaterialMaps) -> f32 {
    let encoded =
        |x: usize, y: usize| pixel(maps, 0, x, y).map(|v| v.clamp(0.0, 1.0).powf(1.0 / 2.2)).iter().sum::<f32>() / 3.0;
    let mut deviations: Vec<f32> = (0..(TILE / 8) * (TILE / 8))
        .map(|block| {
            let (bx, by) = (block % (TILE / 8) * 8, block / (TILE / 8) * 8);
            let values: Vec<f32> = (0..64).map(|k| encoded(bx + k % 8, by + k / 8)).collect();
            let mean = values.iter().sum::<f32>() / 64.0;
            (values.iter().map(|v| (v - mean).powi(2)).sum::<f32>() / 64.0).sqrt()
        })
        .collect();
    deviations.sort_by(f32::total_cmp);
    deviations[deviations.len() / 2]
}

fn paste(sheet: &mut RgbImage, x0: usize, y0: usize, colour: impl Fn(usize, usize) -> [f32; 3]) {
    for y in 0..TILE - 2 {
        for x in 0..TILE - 2 {
            let bytes = colour(x, y).map(|v| (v.clamp(0.0, 1.0).powf(1.0 / 2.2) * 255.0 + 0.5) as u8);
            sheet.put_pixel((x0 + x) as u32, (y0 + y) as u32, Rgb(bytes));
        }
    }
}

/// Mean over the texels of a pixel.
fn pixel(maps: &MaterialMaps, picture: usize, x: usize, y: usize) -> [f32; 3] {
    let per = WINDOW / TILE;
    let offset = (SIZE - WINDOW) / 2;
    let mut sum = [0.0; 3];
    for sy in 0..per {
        for sx in 0..per {
            let (tx, ty) = (offset + x * per + sx, offset + y * per + sy);
            let at = |planes: &ops::planes::Planes| -> [f32; 3] {
                std::array::from_fn(|c| planes.at(c.min(planes.channels - 1), ty, tx))
            };
            let texel = Texel {
                normal: at(&maps.normal),
                diffuse: at(&maps.diffuse),
                roughness: at(&maps.roughness)[0],
                specular: at(&maps.specular),
            };
            let value = match picture {
                0 => flash(&texel, x, y),
                1 => texel.normal.map(|v| (0.5 * v + 0.5).powf(2.2)),
                2 => texel.diffuse,
                3 => [texel.roughness.powf(2.2); 3],
                _ => texel.specular,
            };
            (0..3).for_each(|c| sum[c] += value[c] / (per * per) as f32);
        }
    }
    sum
}

/// The window lit and seen from straight above, as bright as the diffuse albedo in its middle.
fn flash(texel: &Texel, x: usize, y: usize) -> [f32; 3] {
    const EYE: [f32; 3] = [0.0, 0.0, 1.0];
    let flash = Light::Flash { position: EYE, axis: [0.0, 0.0, -1.0], intensity: std::f32::consts::PI, exponent: 0.0 };
    let at = |p: usize| (2.0 * p as f32 / TILE as f32 - 1.0) * TAN;
    radiance(texel, [at(x), -at(y), 0.0], EYE, &[flash], BrdfModel::default())
}
