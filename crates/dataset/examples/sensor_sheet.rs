//! Draws what each option of the sensor does to a video of generated bricks.
//!
//! ```text
//! cargo run -p dataset --example sensor_sheet -- OUT.png [RESOLUTION]
//! ```
//!
//! Rows: ideal sensor; vignetting; exposure drift; white-balance drift; motion blur; lens distortion; rolling shutter;
//! compression; all of them at the defaults of a phone. The rows between the first and the last are stronger than those
//! defaults, for the eye. Columns: frames 10, 60 and 120 of one video; then frame 120 less that of the ideal sensor, times
//! 2, about grey.

use std::sync::Arc;

use dataset::material::augment::AugmentConfig;
use dataset::material::procedural::{Family, generate};
use dataset::material::{Material, MaterialInfo};
use dataset::sequence::sensor::SensorConfig;
use dataset::sequence::{Sequence, SequenceConfig};
use dataset::stream::Stream;
use ops::planes::Planes;
use render::visual::{below, beside};

/// One line per row: a table of `dataset::sequence::sensor::SensorConfig`.
const OPTIONS: &str = "
vignetting = { corner_loss = [0.6, 0.6] }
exposure = { stops = 1.0 }
white_balance = { stops = 0.4 }
motion_blur = { shutter = [0.8, 0.8] }
distortion = { k1 = [-0.5, -0.5], k2 = [-0.3, -0.3] }
rolling_shutter = { readout = [1.0, 1.0] }
compression = { quality = [12, 12] }";
const FRAMES: [usize; 3] = [10, 60, 120];
/// Factor on the difference from the ideal sensor.
const DIFFERENCE_GAIN: f32 = 2.0;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let out = arguments.next().ok_or("usage: sensor_sheet OUT.png [RESOLUTION]")?;
    let res: usize = arguments.next().map_or(Ok(160), |text| text.parse())?;
    let material = bricks()?;
    let mut rows = vec![];
    let mut ideal: Option<Planes> = None;
    let options: Result<Vec<SensorConfig>, _> = OPTIONS.lines().map(toml::from_str).collect();
    for sensor in options?.into_iter().chain([SensorConfig::phone()]) {
        let mut config = SequenceConfig { sensor, augment: AugmentConfig::none(), ..SequenceConfig::svbrdf() };
        config.path.line_share = 0.0;
        config.validate()?;
        let video = Sequence::new(Arc::clone(&material), &config, &Stream::new(2), 0);
        let frames = FRAMES.map(|frame| video.frame(frame, res));
        let reference = ideal.get_or_insert_with(|| frames[2].clone());
        let difference = Planes {
            data: frames[2].data.iter().zip(&reference.data).map(|(a, b)| 0.5 + DIFFERENCE_GAIN * (a - b)).collect(),
            ..frames[2].clone()
        };
        rows.push(beside(&[&frames[0], &frames[1], &frames[2], &difference]));
    }
    let sheet = below(&rows.iter().collect::<Vec<_>>());
    image::RgbImage::from_fn(sheet.width as u32, sheet.height as u32, |x, y| {
        image::Rgb([0, 1, 2].map(|c| (sheet.at(c, y as usize, x as usize).clamp(0.0, 1.0) * 255.0).round() as u8))
    })
    .save(out)?;
    Ok(())
}

fn bricks() -> Result<Arc<Material>, Box<dyn std::error::Error>> {
    let family = Family::Bricks;
    let info = MaterialInfo { texels: 2048, ..MaterialInfo::made_up(family.name()) };
    Ok(Arc::new(Material::from_maps(info, &generate(family, 3, 1024))?))
}
