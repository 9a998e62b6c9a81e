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

#[path = "material_coverage/lettering.rs"]
mod lettering;

use std::sync::Arc;

use dataset::material::augment::AugmentConfig;
use dataset::material::procedural::{Family, generate};
use dataset::material::{Material, MaterialInfo};
use dataset::sequence::sensor::SensorConfig;
use dataset::sequence::{Sequence, SequenceConfig};
use dataset::stream::Stream;
use image::{Rgb, RgbImage};
use ops::planes::Planes;

/// One line per row: a table of `dataset::sequence::sensor::SensorConfig`; none for the ideal sensor.
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
/// Paper around pictures and texts, in pixels.
const GAP: usize = 4;
const PAPER: [u8; 3] = [250, 250, 248];
const INK: [u8; 3] = [40, 40, 40];

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let out = arguments.next().ok_or("usage: sensor_sheet OUT.png [RESOLUTION]")?;
    let res: usize = arguments.next().map_or(Ok(160), |text| text.parse())?;
    let material = bricks()?;
    let options: Vec<SensorConfig> = OPTIONS.lines().map(toml::from_str).collect::<Result<_, _>>()?;
    let name = |line: &str| line.split_once(" =").map_or("ideal".into(), |(name, _)| name.replace('_', " "));
    let names: Vec<String> = OPTIONS.lines().map(name).chain(["all of them".into()]).collect();
    let mut sheet = Sheet::new(&names, res);
    let mut ideal: Option<Planes> = None;
    for (row, sensor) in options.into_iter().chain([SensorConfig::phone()]).enumerate() {
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
        frames.iter().chain([&difference]).enumerate().for_each(|(column, picture)| sheet.paste(row, column, picture));
    }
    sheet.picture.save(out)?;
    Ok(())
}

/// Pictures in rows and columns with a little paper between them, and what they are beside and above.
struct Sheet {
    picture: RgbImage,
    /// The first picture's corner.
    corner: [usize; 2],
    res: usize,
}

impl Sheet {
    fn new(names: &[String], res: usize) -> Self {
        let titles = FRAMES.map(|frame| format!("frame {frame}")).into_iter().chain(["difference".into()]);
        let label_width = names.iter().map(|name| lettering::width(name)).max().unwrap_or(0);
        let corner = [label_width + 2 * GAP, lettering::HEIGHT + 2 * GAP];
        let side = |corner: usize, count: usize| (corner + count * (res + GAP)) as u32;
        let size = [side(corner[0], FRAMES.len() + 1), side(corner[1], names.len())];
        let mut sheet = Self { picture: RgbImage::from_pixel(size[0], size[1], Rgb(PAPER)), corner, res };
        for (column, title) in titles.enumerate() {
            let x = sheet.place(0, column)[0];
            lettering::write(&mut sheet.picture, [x, GAP], &title, INK);
        }
        for (row, name) in names.iter().enumerate() {
            let y = sheet.place(row, 0)[1];
            lettering::write(&mut sheet.picture, [GAP, y], name, INK);
        }
        sheet
    }

    fn place(&self, row: usize, column: usize) -> [usize; 2] {
        [self.corner[0] + column * (self.res + GAP), self.corner[1] + row * (self.res + GAP)]
    }

    fn paste(&mut self, row: usize, column: usize, picture: &Planes) {
        let [x0, y0] = self.place(row, column);
        for (y, x) in (0..self.res * self.res).map(|i| (i / self.res, i % self.res)) {
            let codes = [0, 1, 2].map(|c| (picture.at(c, y, x).clamp(0.0, 1.0) * 255.0).round() as u8);
            self.picture.put_pixel((x0 + x) as u32, (y0 + y) as u32, Rgb(codes));
        }
    }
}

fn bricks() -> Result<Arc<Material>, Box<dyn std::error::Error>> {
    let family = Family::Bricks;
    let info = MaterialInfo { texels: 2048, ..MaterialInfo::made_up(family.name()) };
    Ok(Arc::new(Material::from_maps(info, &generate(family, 3, 1024))?))
}
