//! Writes contact sheets of synthetic videos and chairs pairs, and prints how fast frames are made.
//!
//! ```text
//! cargo run -p dataset --example sequence_sheet -- FOLDER [RESOLUTION]
//! ```
//!
//! `sequences.png`, one row per material: guidance frame; next frame; frame 40; frame 40 warped to the guidance frame
//! (what it doesn't see is red); flow arrows from the guidance to the next frame; normal, diffuse, roughness and specular
//! of the guidance frame. `chairs.png`, one row per pair: first; second; second warped to first (hidden pixels red);
//! flow arrows.

use std::convert::Infallible;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use dataset::chairs::{Chairs, ChairsConfig};
use dataset::image_io::{Overwrite, write_png8};
use dataset::material::procedural::{Family, generate};
use dataset::material::{Material, MaterialInfo};
use dataset::sequence::{Sequence, SequenceConfig};
use dataset::stream::Stream;
use ops::flow_field::warp_planes;
use ops::planes::{Mask, Planes};
use render::visual::{below, beside, row_picture};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let folder = PathBuf::from(arguments.next().ok_or("usage: sequence_sheet FOLDER [RESOLUTION]")?);
    let res: usize = arguments.next().map_or(Ok(256), |text| text.parse())?;
    std::fs::create_dir_all(&folder)?;
    let step = Family::ALL.len().div_ceil(6);
    let materials: Vec<Arc<Material>> =
        Family::ALL.iter().step_by(step).map(|&family| material(family)).collect::<Result<_, _>>()?;
    let streams = Stream::new(1);
    let (mut rows, mut seconds, mut frames) = (vec![], 0.0, 0);
    for (video, material) in materials.iter().enumerate() {
        let config = if video % 2 == 0 { SequenceConfig::svbrdf() } else { SequenceConfig::flow() };
        let sequence = Sequence::new(Arc::clone(material), &config, &streams, video as u64);
        let began = Instant::now();
        let made: Vec<Planes> = (0..60).map(|i| sequence.frame(i, res)).collect();
        let took = began.elapsed().as_secs_f64();
        println!("{:>24}: {:6.1} frames/s at {res}²", sequence.material(), made.len() as f64 / took);
        seconds += took;
        frames += made.len();
        rows.push(sequence_row(&sequence, &made, res));
    }
    println!("{:>24}: {:6.1} frames/s on {} threads", "all", frames as f64 / seconds, rayon::current_num_threads());
    save(&folder.join("sequences.png"), &rows)?;

    let chairs = Chairs::new(ChairsConfig { resolution: res, ..ChairsConfig::default() }, streams)?;
    let material = |n: u64| Ok::<_, Infallible>(Arc::clone(&materials[n as usize % materials.len()]));
    let began = Instant::now();
    let pairs = (0..5).map(|i| chairs.pair(i, material)).collect::<Result<Vec<_>, _>>()?;
    println!("{:>24}: {:6.1} pairs/s", "chairs", pairs.len() as f64 / began.elapsed().as_secs_f64());
    let rows: Vec<Planes> = pairs
        .iter()
        .map(|p| {
            let (warped, _) = warp_planes(&p.second, &p.flow);
            beside(&[&p.first, &p.second, &masked(&warped, &p.valid), &arrows(&p.first, &p.flow)])
        })
        .collect();
    save(&folder.join("chairs.png"), &rows)?;
    Ok(())
}

fn material(family: Family) -> Result<Arc<Material>, Box<dyn std::error::Error>> {
    let info = MaterialInfo { textured: None, ..MaterialInfo::made_up(family.name()) };
    Ok(Arc::new(Material::from_maps(info, &generate(family, 3, 1024))?))
}

fn sequence_row(sequence: &Sequence, frames: &[Planes], res: usize) -> Planes {
    let (flow, valid) = sequence.flow(0, 40, res);
    let (warped, _) = warp_planes(&frames[40], &flow);
    let moved = arrows(&frames[0], &sequence.flow(0, 1, res).0);
    let maps = row_picture(&sequence.target_maps(0, res));
    beside(&[&frames[0], &frames[1], &frames[40], &masked(&warped, &valid), &moved, &maps])
}

fn masked(image: &Planes, valid: &Mask) -> Planes {
    let mut out = image.clone();
    for i in (0..out.area()).filter(|&i| !valid.data[i]) {
        out.plane_mut(0)[i] = 0.8;
        out.plane_mut(1)[i] = 0.0;
        out.plane_mut(2)[i] = 0.0;
    }
    out
}

/// Draws the flow of every 16th pixel as a line from a white dot.
fn arrows(image: &Planes, flow: &Planes) -> Planes {
    let mut out = image.clone().map(|v| 0.6 * v);
    let (height, width) = (image.height, image.width);
    for (y, x) in (8..height).step_by(16).flat_map(|y| (8..width).step_by(16).map(move |x| (y, x))) {
        for step in 0..=40 {
            let along = step as f32 / 40.0;
            let (px, py) = (x as f32 + along * flow.at(0, y, x), y as f32 + along * flow.at(1, y, x));
            if px >= 0.0 && py >= 0.0 && (px as usize) < width && (py as usize) < height {
                let colour = if step == 0 { [1.0; 3] } else { [1.0, 0.8, 0.0] };
                (0..3).for_each(|c| out.set(c, py as usize, px as usize, colour[c]));
            }
        }
    }
    out
}

fn save(path: &Path, rows: &[Planes]) -> Result<(), Box<dyn std::error::Error>> {
    write_png8(path, &below(&rows.iter().collect::<Vec<_>>()), Overwrite::Allow)?;
    println!("{}", path.display());
    Ok(())
}
