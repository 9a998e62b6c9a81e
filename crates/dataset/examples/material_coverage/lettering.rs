//! Capital letters and digits of 3 × 5 dots: enough to name the parts of a diagram.

use image::{Rgb, RgbImage};

/// Pixels per dot.
const DOT: usize = 2;
/// Height of a line of text.
pub const HEIGHT: usize = 5 * DOT;

/// Rows from the top, three dots each.
#[rustfmt::skip]
const GLYPHS: &[(char, u16)] = &[
    (',', 0b000_000_000_010_100), ('-', 0b000_000_111_000_000), ('.', 0b000_000_000_000_010), ('0', 0b111_101_101_101_111),
    ('1', 0b010_110_010_010_111), ('2', 0b110_001_010_100_111), ('3', 0b110_001_010_001_110), ('4', 0b101_101_111_001_001),
    ('5', 0b111_100_110_001_110), ('6', 0b011_100_111_101_111), ('7', 0b111_001_010_010_010), ('8', 0b111_101_111_101_111),
    ('9', 0b111_101_111_001_110), ('A', 0b010_101_111_101_101), ('B', 0b110_101_110_101_110), ('C', 0b011_100_100_100_011),
    ('D', 0b110_101_101_101_110), ('E', 0b111_100_110_100_111), ('F', 0b111_100_110_100_100), ('G', 0b011_100_101_101_011),
    ('H', 0b101_101_111_101_101), ('I', 0b111_010_010_010_111), ('J', 0b001_001_001_101_010), ('K', 0b101_101_110_101_101),
    ('L', 0b100_100_100_100_111), ('M', 0b101_111_111_101_101), ('N', 0b110_101_101_101_101), ('O', 0b010_101_101_101_010),
    ('P', 0b110_101_110_100_100), ('Q', 0b010_101_101_110_011), ('R', 0b110_101_110_101_101), ('S', 0b011_100_010_001_110),
    ('T', 0b111_010_010_010_010), ('U', 0b101_101_101_101_111), ('V', 0b101_101_101_101_010), ('W', 0b101_101_111_111_101),
    ('X', 0b101_101_010_101_101), ('Y', 0b101_101_010_010_010), ('Z', 0b111_001_010_100_111),
];

/// Writes from left to right; characters without a glyph stay blank.
pub fn write(picture: &mut RgbImage, [x, y]: [usize; 2], text: &str, colour: [u8; 3]) {
    for (i, character) in text.to_uppercase().chars().enumerate() {
        let Some((_, dots)) = GLYPHS.iter().find(|(glyph, _)| *glyph == character) else { continue };
        for dot in (0..15).filter(|dot| dots >> (14 - dot) & 1 == 1) {
            let corner = [x + (4 * i + dot % 3) * DOT, y + dot / 3 * DOT];
            (0..DOT * DOT).for_each(|p| {
                let [px, py] = [corner[0] + p % DOT, corner[1] + p / DOT].map(|v| v as u32);
                if px < picture.width() && py < picture.height() {
                    picture.put_pixel(px, py, Rgb(colour));
                }
            });
        }
    }
}

/// Width of a text.
pub fn width(text: &str) -> usize {
    4 * DOT * text.chars().count()
}
