//! Image files in and out (PNG, JPEG, EXR; Radiance HDR only in), with the stored encoding kept as a type until a reader decides what it means.
//!
//! Files are written whole or not at all (a temporary file in the same folder, then a rename), and never over another
//! file unless that is asked for.

mod decode;
mod error;
pub mod lens;
mod write;

use std::path::Path;

use ops::planes::Planes;

pub use error::ImageError;
pub use write::{Overwrite, write_bytes, write_exr, write_png8, write_png16};

/// Widest and highest image that is read.
pub const MAX_SIDE: usize = 16_384;

/// What an image file stores, interleaved by pixel.
#[derive(Clone, Debug, PartialEq)]
pub enum Samples {
    /// 8-bit integers, usually encoded (sRGB) for colours.
    Eight(Vec<u8>),
    /// 16-bit integers, usually encoded (sRGB) for colours.
    Sixteen(Vec<u16>),
    /// Floats of an EXR or HDR: linear by these formats' definition, all finite.
    Linear(Vec<f32>),
}

impl Samples {
    /// The stored number; integers as a share of their largest.
    #[inline]
    pub fn share(&self, index: usize) -> f32 {
        match self {
            Self::Eight(v) => f32::from(v[index]) / 255.0,
            Self::Sixteen(v) => f32::from(v[index]) / 65535.0,
            Self::Linear(v) => v[index],
        }
    }
}

/// An image as its file stores it.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// 1 (grey) or 3 (red, green, blue); an alpha channel is dropped.
    pub channels: usize,
    /// `(y · width + x) · channels + channel`.
    pub samples: Samples,
}

impl Picture {
    /// Reads a PNG, JPEG, EXR or HDR file, told apart by content. Photos are turned upright (EXIF orientation).
    ///
    /// # Errors
    /// A missing, empty, truncated, oversized or foreign file, and NaN or infinity in an EXR, each by its own
    /// [`ImageError`].
    pub fn read(path: &Path) -> Result<Self, ImageError> {
        decode::read(path)
    }

    /// As [`Picture::read`] for a file's bytes; errors name `path`.
    ///
    /// # Errors
    /// As [`Picture::read`].
    pub fn decode(bytes: &[u8], path: &Path) -> Result<Self, ImageError> {
        decode::decode(bytes, path)
    }

    /// The stored value; integers as a share of their largest.
    #[inline]
    pub fn value(&self, channel: usize, x: usize, y: usize) -> f32 {
        self.samples.share((y * self.width + x) * self.channels + channel.min(self.channels - 1))
    }

    /// The stored values as they are ([`Picture::value`]), channel by channel.
    pub fn to_planes(&self) -> Planes {
        let mut planes = Planes::new(self.channels, self.height, self.width);
        for c in 0..self.channels {
            for (i, value) in planes.plane_mut(c).iter_mut().enumerate() {
                *value = self.value(c, i % self.width, i / self.width);
            }
        }
        planes
    }

    /// The picture as gamma-encoded RGB, the form frames have everywhere: integers as stored, linear floats encoded.
    pub fn to_frame(&self) -> Planes {
        let planes = self.to_planes();
        let planes = match self.samples {
            Samples::Linear(_) => planes.map(|v| ops::colour::gamma_encode(v).min(1.0)),
            _ => planes,
        };
        if self.channels == 3 { planes } else { Planes::stack(&[&planes, &planes, &planes]) }
    }

    /// Another size in the same encoding: area mean when smaller, bilinear when larger. Filters stored values.
    pub fn resized(&self, width: usize, height: usize) -> Self {
        if (width, height) == (self.width, self.height) {
            return self.clone();
        }
        let planes = self.to_planes().resize_area(height, width);
        let interleaved = (0..height * width).flat_map(|i| (0..self.channels).map(move |c| (c, i)));
        let values = interleaved.map(|(c, i)| planes.plane(c)[i]);
        let samples = match self.samples {
            Samples::Eight(_) => Samples::Eight(values.map(|v| (v * 255.0 + 0.5) as u8).collect()),
            Samples::Sixteen(_) => Samples::Sixteen(values.map(|v| (v * 65535.0 + 0.5) as u16).collect()),
            Samples::Linear(_) => Samples::Linear(values.collect()),
        };
        Self { width, height, channels: self.channels, samples }
    }
}

#[cfg(test)]
mod tests;
