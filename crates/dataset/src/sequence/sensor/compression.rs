//! Compression of single frames.

use std::io::Cursor;

use image::ImageDecoder;
use image::codecs::jpeg::JpegDecoder;
use jpeg_encoder::{ColorType, Encoder, SamplingFactor};
use ops::planes::Planes;

/// Side of the squares that are compressed one by one: colour has half the resolution, in blocks of 8 samples.
pub const BLOCK: usize = 16;

/// How many pixels a decoder reaches over a square's border, because it interpolates colour between samples.
pub const REACH: usize = 2;

/// A frame after a trip through JPEG at the given quality, 1 to 100, colour at half resolution (4:2:0) as in videos.
///
/// # Shapes
/// 3 planes with multiples of 1/255, as [`render::sensor::expose`] makes them, in and out.
pub fn compressed(frame: &Planes, quality: u8) -> Planes {
    const IN_MEMORY: &str = "8-bit RGB with sides of at most 65535 pixels fits a JPEG in memory";
    let (width, height, area) = (frame.width, frame.height, frame.area());
    let side = |pixels: usize| u16::try_from(pixels).expect(IN_MEMORY);
    let mut bytes = vec![0; 3 * area];
    for (c, plane) in frame.data.chunks_exact(area).enumerate() {
        for (pixel, value) in bytes.chunks_exact_mut(3).zip(plane) {
            pixel[c] = (value * 255.0 + 0.5) as u8;
        }
    }
    let mut file = Vec::new();
    let mut encoder = Encoder::new(&mut file, quality);
    encoder.set_sampling_factor(SamplingFactor::F_2_2);
    encoder.encode(&bytes, side(width), side(height), ColorType::Rgb).expect(IN_MEMORY);
    JpegDecoder::new(Cursor::new(file)).and_then(|decoder| decoder.read_image(&mut bytes)).expect(IN_MEMORY);
    let mut out = Planes::new(3, height, width);
    for (c, plane) in out.data.chunks_exact_mut(area).enumerate() {
        for (value, pixel) in plane.iter_mut().zip(bytes.chunks_exact(3)) {
            *value = f32::from(pixel[c]) / 255.0;
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Waves of brightness with a faint colour, which half the resolution holds: no block is even.
    fn picture(side: usize) -> Planes {
        let mut planes = Planes::new(3, side, side);
        for (i, value) in planes.data.iter_mut().enumerate() {
            let (c, y, x) = (i / (side * side), i / side % side, i % side);
            let wave = (0.35 * x as f32).sin() * (0.27 * y as f32).cos();
            *value = ((0.5 + (0.35 - 0.03 * c as f32) * wave) * 255.0).round() / 255.0;
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
    fn colour_has_half_the_resolution_and_luminance_all_of_it() {
        // Columns of pixels that alternate in colour at the same luminance, then in luminance at the same colour.
        let stripes = |a: [f32; 3], b: [f32; 3]| {
            let mut planes = Planes::new(3, 32, 32);
            for (i, value) in planes.data.iter_mut().enumerate() {
                *value = if i % 2 == 0 { a[i / 1024] } else { b[i / 1024] } / 255.0;
            }
            planes
        };
        let contrast = |planes: &Planes, c: usize| {
            let row = &planes.data[c * 1024 + 16 * 32..][..32];
            row.chunks(2).map(|pair| (pair[0] - pair[1]).abs() * 255.0).sum::<f32>() / 16.0
        };
        // Y = 0.299 R + 0.587 G + 0.114 B is 100 for both.
        let colour = compressed(&stripes([140.0, 79.6, 100.0], [60.0, 120.4, 100.0]), 100);
        assert!(contrast(&colour, 0) < 8.0, "{} of 80 codes are left", contrast(&colour, 0));
        let luminance = compressed(&stripes([140.0; 3], [60.0; 3]), 100);
        assert!((contrast(&luminance, 0) - 80.0).abs() < 4.0, "{} of 80 codes are left", contrast(&luminance, 0));
    }

    #[test]
    fn blocks_are_compressed_one_by_one() {
        let frame = picture(90);
        let whole = compressed(&frame, 35);
        for (y, x, height, width) in [(0, 0, 16, 16), (16, 32, 64, 32), (16, 48, 74, 42), (64, 64, 26, 26)] {
            // The inside of a part: at its border the decoder would have looked at the neighbours.
            let part = compressed(&frame.crop(y, x, height, width), 35);
            let first = |v: usize| if v == 0 { 0 } else { REACH };
            let last = |v: usize, length: usize| if v + length == 90 { length } else { length - REACH };
            let (top, left) = (first(y), first(x));
            let (bottom, right) = (last(y, height), last(x, width));
            let inside = part.crop(top, left, bottom - top, right - left);
            assert_eq!(inside, whole.crop(y + top, x + left, bottom - top, right - left), "{y} {x}");
        }
    }
}
