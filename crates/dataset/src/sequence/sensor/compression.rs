//! Compression of single frames.

use std::io::Cursor;

use image::codecs::jpeg::{JpegDecoder, JpegEncoder};
use image::{ExtendedColorType, ImageDecoder};
use ops::planes::Planes;

/// Side of the squares that JPEG treats one by one; at full colour resolution nothing reaches across their borders.
pub const BLOCK: usize = 8;

/// A frame after a trip through JPEG at the given quality, 1 to 100.
///
/// # Shapes
/// 3 planes with multiples of 1/255, as [`render::sensor::Sensor::expose`] makes them, in and out.
pub fn compressed(frame: &Planes, quality: u8) -> Planes {
    const IN_MEMORY: &str = "8-bit RGB with sides of at most 65535 pixels fits a JPEG in memory";
    let (width, height, area) = (frame.width, frame.height, frame.area());
    let mut bytes: Vec<u8> =
        (0..area).flat_map(|i| (0..3).map(move |c| (frame.data[c * area + i] * 255.0).round() as u8)).collect();
    let mut file = Vec::new();
    JpegEncoder::new_with_quality(&mut file, quality)
        .encode(&bytes, width as u32, height as u32, ExtendedColorType::Rgb8)
        .expect(IN_MEMORY);
    JpegDecoder::new(Cursor::new(file)).and_then(|decoder| decoder.read_image(&mut bytes)).expect(IN_MEMORY);
    let data = (0..3).flat_map(|c| bytes.iter().skip(c).step_by(3).map(|&code| f32::from(code) / 255.0)).collect();
    Planes::from_vec(3, height, width, data)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Waves in colour: no block is even.
    fn picture(side: usize) -> Planes {
        let mut planes = Planes::new(3, side, side);
        for (i, value) in planes.data.iter_mut().enumerate() {
            let (c, y, x) = (i / (side * side), i / side % side, i % side);
            let wave = ((0.35 + 0.1 * c as f32) * x as f32).sin() * (0.27 * y as f32).cos();
            *value = ((0.5 + 0.35 * wave) * 255.0).round() / 255.0;
        }
        planes
    }

    fn psnr(a: &Planes, b: &Planes) -> f32 {
        let squares: f32 = a.data.iter().zip(&b.data).map(|(a, b)| (a - b).powi(2)).sum();
        -10.0 * (squares / a.data.len() as f32).log10()
    }

    #[test]
    fn a_frame_changes_within_bounds_that_follow_the_quality() {
        let frame = picture(61);
        let [low, middle, high] = [10, 60, 95].map(|quality| psnr(&frame, &compressed(&frame, quality)));
        assert!(low < middle && middle < high, "{low} {middle} {high} dB");
        assert!((18.0..32.0).contains(&low) && high > 38.0 && high < 60.0, "{low} {middle} {high} dB");
        assert_eq!(compressed(&frame, 60), compressed(&frame, 60));
    }

    #[test]
    fn values_stay_codes_and_grey_stays_within_one_code() {
        let out = compressed(&picture(16), 30);
        assert!(out.data.iter().all(|v| (v * 255.0 - (v * 255.0).round()).abs() < 1e-4 && (0.0..=1.0).contains(v)));
        let grey = Planes::constant(9, 5, &[100.0 / 255.0; 3]);
        let error = |v: &f32| (v * 255.0 - 100.0).abs();
        assert!(compressed(&grey, 95).data.iter().all(|v| error(v) < 1.5));
        let pixel = Planes::constant(1, 1, &[0.2, 0.4, 0.6]);
        assert_eq!((compressed(&pixel, 90).height, compressed(&pixel, 90).width), (1, 1));
    }

    #[test]
    fn blocks_are_compressed_one_by_one() {
        let frame = picture(61);
        let whole = compressed(&frame, 35);
        for (y, x, height, width) in [(0, 0, 8, 8), (16, 24, 32, 16), (8, 40, 53, 21), (56, 56, 5, 5)] {
            assert_eq!(compressed(&frame.crop(y, x, height, width), 35), whole.crop(y, x, height, width));
        }
    }
}
