//! How well whole scans are aligned without any net: `cargo run -p flow --example align_materials -- [FOLDER] [COUNT]`.
//!
//! Renders a spiral scan (141 frames of 256²) of every material that the nets never see, of the procedural source or of a
//! folder of texture maps, aligns it and prints the figures of spec 6.1 per material and for textured, low-texture and
//! featureless materials, beside those of no alignment at all.

use std::error::Error;
use std::time::Instant;

use dataset::material::library::{MaterialLibrary, PbrConfig, ProceduralConfig, SourceConfig};
use dataset::material::split::Split;
use dataset::material::texture::Texture;
use dataset::sequence::{Sequence, SequenceConfig};
use dataset::stream::Stream;
use flow::align::metrics::{AlignmentMetrics, ScanErrors, summarise};
use flow::align::size::Size;
use flow::align::{AlignConfig, Aligner};
use ops::homography::Homography;
use ops::planes::Planes;
use rayon::prelude::*;

/// Side of the frames in pixels.
const RES: usize = 256;
/// Texels over the material's [−1, 1].
const TEXELS: usize = 4096;
/// Seed of the scans.
const SEED: u64 = 7;
/// Bytes of decoded materials kept at a time.
const CACHE_BYTES: usize = 256 << 20;

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let source = match arguments.next().filter(|a| a != "procedural") {
        Some(folder) => {
            let wrap = Default::default();
            SourceConfig::Pbr(PbrConfig { path: folder.into(), texels: TEXELS, wrap, weight: 1.0 })
        }
        None => SourceConfig::Procedural(ProceduralConfig::default()),
    };
    let library = MaterialLibrary::open(&[source], 0, CACHE_BYTES)?;
    let held_out = library.len(Split::Test);
    let count = arguments.next().map_or(Ok(held_out), |c| c.parse::<usize>())?.min(held_out);

    let mut config = SequenceConfig::svbrdf();
    config.path.line_share = 0.0;
    let aligner = Aligner { config: AlignConfig::default(), adjacent: None, distant: None };
    let mut groups = [Texture::Rich, Texture::Faint, Texture::Absent].map(|texture| (texture, Vec::new(), Vec::new()));
    for index in 0..count {
        let sequence = Sequence::new(library.nth(Split::Test, index)?, &config, &Stream::new(SEED), index as u64);
        let (aligned, still) = measure(&aligner, &sequence)?;
        if let Some((_, of_aligned, of_still)) = groups.iter_mut().find(|group| group.0 == sequence.texture()) {
            of_aligned.push(aligned);
            of_still.push(still);
        }
    }
    for (texture, aligned, still) in groups.iter().filter(|group| !group.1.is_empty()) {
        let name = match texture {
            Texture::Rich => "textured",
            Texture::Faint => "low texture",
            Texture::Absent => "featureless",
        };
        print(&format!("{name} ({} scans)", aligned.len()), &summarise(aligned));
        print("  identity", &summarise(still));
    }
    Ok(())
}

/// Errors of the alignment and of no alignment.
fn measure(aligner: &Aligner, sequence: &Sequence) -> Result<(ScanErrors, ScanErrors), Box<dyn Error>> {
    let frames: Vec<Planes> = (0..sequence.len()).into_par_iter().map(|i| sequence.frame(i, RES)).collect();
    let start = Instant::now();
    let alignment = aligner.align(&frames, None)?;
    let seconds = start.elapsed().as_secs_f64();
    let size = Size::of(&frames[0]);
    let exact: Vec<Homography> = alignment.key_frames.iter().map(|k| sequence.homography(0, k.index, RES)).collect();
    let errors = ScanErrors::new(&alignment, &exact, size);
    let still = vec![Some(Homography::identity()); exact.len()];
    let dropped = alignment.key_frames.iter().filter(|k| !k.aligned()).count();
    print(sequence.material(), &summarise(std::slice::from_ref(&errors)));
    println!("{:32} {dropped} dropped, {seconds:.1} s", "");
    Ok((errors, ScanErrors::of_homographies(&still, &exact, size, size)))
}

fn print(name: &str, m: &AlignmentMetrics) {
    println!(
        "{name:32} valid {:.3}  error mean {:6.2} median {:6.2} p95 {:6.2}  penalised {:5.2}  ≤20 px {:.2}  ≤4 px {:.2}",
        m.valid_rate, m.pixel_error, m.pixel_error_median, m.pixel_error_p95, m.penalised_error, m.within_20px, m.within_4px
    );
}
