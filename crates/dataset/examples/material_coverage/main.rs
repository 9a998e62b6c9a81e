//! Compares generated materials with the materials of a folder: how rough, bright, coloured, bumpy and detailed both are, and
//! which of the folder's materials are like nothing that is generated.
//!
//! Prints Markdown and draws a picture with the histograms of both.
//!
//! `cargo run -p dataset --example material_coverage -- FOLDER OUT.png [SEEDS]`
//!
//! FOLDER holds a folder of texture maps per material; SEEDS is how many materials of each family are generated (10, as in
//! a run's default).

mod coverage;
mod lettering;
mod picture;
mod spectrum;
mod statistics;
mod tables;

use dataset::material::library::{PbrConfig, ProceduralConfig};
use dataset::material::procedural::Family;
use dataset::material::{GRID, MaterialLibrary, SourceConfig, Split, Wrap};
use rayon::prelude::*;

use coverage::Coverage;
use statistics::Statistics;

type Failure = Box<dyn std::error::Error + Send + Sync>;

const USAGE: &str = "usage: material_coverage FOLDER OUT.png [SEEDS]";

fn main() -> Result<(), Failure> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [folder, out, rest @ ..] = &arguments[..] else { return Err(USAGE.into()) };
    let seeds: usize = match rest {
        [] => 10,
        [seeds] => seeds.parse().ok().filter(|seeds| *seeds > 0).ok_or(USAGE)?,
        _ => return Err(USAGE.into()),
    };
    let pbr = PbrConfig { path: folder.into(), texels: GRID, wrap: Wrap::Repeat, weight: 1.0 };
    let procedural = ProceduralConfig { count: seeds * Family::ALL.len(), ..ProceduralConfig::default() };
    let real = measure(SourceConfig::Pbr(pbr))?;
    let generated = measure(SourceConfig::Procedural(procedural))?;
    let coverage = Coverage::new(&real, &generated);
    print!("{}", tables::markdown(&real, &generated, &coverage));
    picture::draw(&real, &generated).save(out)?;
    Ok(())
}

/// Every material of a source, of both sides of the split.
fn measure(source: SourceConfig) -> Result<Vec<Statistics>, Failure> {
    // Each is looked at once: nothing is kept.
    let library = MaterialLibrary::open(&[source], 0, 0)?;
    let of_side = |side: Split| {
        let count = library.len(side);
        (0..count).map(move |index| (side, index))
    };
    let places: Vec<(Split, usize)> = of_side(Split::Train).chain(of_side(Split::Test)).collect();
    eprintln!("measuring {} materials", places.len());
    places.par_iter().map(|&(side, index)| Ok(Statistics::of(&*library.nth(side, index)?))).collect()
}
