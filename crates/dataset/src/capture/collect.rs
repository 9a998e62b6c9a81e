//! Gathers frames as they come: cuts, shrinks and checks each, and thins evenly when there are too many.

use std::path::{Path, PathBuf};

use ops::colour::{GAMMA, gamma_encode};
use ops::planes::Planes;

use crate::image_io::lens::Lens;

use super::{CaptureConfig, CaptureError, Clip, ClipKind, Crop, MIN_SIDE};

/// A frame whose mean encoded value lies below this shows nothing but sensor noise.
const BLACK_MEAN: f32 = 0.012;

/// Cuts and shrinks frames of one size.
pub(super) struct Fit {
    /// Column, row, width and height of what is kept.
    pub window: [usize; 4],
    /// Columns and rows of the result.
    pub size: [usize; 2],
}

impl Fit {
    pub(super) fn new(path: &Path, config: &CaptureConfig, width: usize, height: usize) -> Result<Self, CaptureError> {
        let shorter = width.min(height);
        if shorter < MIN_SIDE {
            return Err(CaptureError::TooSmall { path: path.into(), width, height });
        }
        let window = match config.crop {
            Crop::Square => [(width - shorter) / 2, (height - shorter) / 2, shorter, shorter],
            Crop::None => [0, 0, width, height],
        };
        let target = config.resolution.unwrap_or(shorter).min(shorter);
        let scaled = |side: usize| (side * target + shorter / 2) / shorter;
        Ok(Self { window, size: [scaled(window[2]), scaled(window[3])] })
    }

    /// Cuts and shrinks an encoded frame; light is averaged, not encoded values.
    pub(super) fn planes(&self, frame: Planes) -> Planes {
        let [x, y, width, height] = self.window;
        let cut = if (width, height) == (frame.width, frame.height) { frame } else { frame.crop(y, x, height, width) };
        if self.size == [width, height] {
            return cut;
        }
        cut.map(|v| v.max(0.0).powf(GAMMA)).resize_area(self.size[1], self.size[0]).map(gamma_encode)
    }

    /// The same for interleaved RGB integers, with `linear` holding the light of every integer value and `primaries` the
    /// matrix from the source's colours to those of frames.
    pub(super) fn integers<T: Copy + Into<usize>>(
        &self,
        pixels: &[T],
        width: usize,
        linear: &[f32],
        primaries: Option<[[f32; 3]; 3]>,
    ) -> Planes {
        let [left, top, columns, rows] = self.window;
        let mut light = Planes::new(3, rows, columns);
        for c in 0..3 {
            let plane = light.plane_mut(c);
            for (y, row) in plane.chunks_exact_mut(columns).enumerate() {
                let source = &pixels[((top + y) * width + left) * 3..][..columns * 3];
                row.iter_mut().zip(source.chunks_exact(3)).for_each(|(v, pixel)| *v = linear[pixel[c].into()]);
            }
        }
        let mut light = light.resize_area(self.size[1], self.size[0]);
        if let Some(matrix) = primaries {
            let area = light.area();
            for i in 0..area {
                let rgb: [f32; 3] = std::array::from_fn(|c| light.data[c * area + i]);
                for (c, row) in matrix.iter().enumerate() {
                    light.data[c * area + i] = row.iter().zip(rgb).map(|(m, v)| m * v).sum();
                }
            }
        }
        light.map(|v| gamma_encode(v).min(1.0))
    }
}

/// The frames kept so far.
pub(super) struct Collector<'a> {
    path: PathBuf,
    config: &'a CaptureConfig,
    source_size: Option<[usize; 2]>,
    fit: Option<Fit>,
    frames: Vec<Planes>,
    indices: Vec<usize>,
    capacity: usize,
    stride: usize,
    seen: usize,
    black: Vec<usize>,
    pub notes: Vec<String>,
    /// What the pictures' metadata say of the lens.
    pub lens: Option<Lens>,
}

impl<'a> Collector<'a> {
    pub(super) fn new(path: &Path, config: &'a CaptureConfig) -> Self {
        Self {
            path: path.into(),
            config,
            source_size: None,
            fit: None,
            frames: Vec::new(),
            indices: Vec::new(),
            capacity: config.max_frames,
            stride: 1,
            seen: 0,
            black: Vec::new(),
            notes: Vec::new(),
            lens: None,
        }
    }

    /// Frames offered so far.
    pub(super) fn seen(&self) -> usize {
        self.seen
    }

    /// Offers the next frame of `width × height`; `make` is called only when the frame may be kept.
    pub(super) fn push(
        &mut self,
        width: usize,
        height: usize,
        make: impl FnOnce(&Fit) -> Result<Planes, CaptureError>,
    ) -> Result<(), CaptureError> {
        let frame = self.seen;
        let expected = *self.source_size.get_or_insert([width, height]);
        if expected != [width, height] {
            return Err(CaptureError::Sizes { path: self.path.clone(), frame, found: [width, height], expected });
        }
        if self.fit.is_none() {
            self.begin(width, height)?;
        }
        let Some(fit) = &self.fit else { return Ok(()) };
        self.seen += 1;
        if !frame.is_multiple_of(self.stride) {
            return Ok(());
        }
        let planes = make(fit)?;
        if !planes.data.iter().all(|v| v.is_finite()) {
            return Err(CaptureError::NonFinite { path: self.path.clone(), frame });
        }
        if planes.data.iter().sum::<f32>() / planes.data.len() as f32 <= BLACK_MEAN {
            self.black.push(frame);
            return Ok(());
        }
        if self.frames.len() == self.capacity {
            self.thin();
        }
        if frame.is_multiple_of(self.stride) {
            self.frames.push(planes);
            self.indices.push(frame);
        }
        Ok(())
    }

    fn begin(&mut self, width: usize, height: usize) -> Result<(), CaptureError> {
        let fit = Fit::new(&self.path, self.config, width, height)?;
        let frame_bytes = fit.size[0] * fit.size[1] * 3 * size_of::<f32>();
        let fitting = self.config.max_mib.saturating_mul(1 << 20) / frame_bytes;
        if fitting < 2 {
            let frame_mib = frame_bytes.div_ceil(1 << 20);
            return Err(CaptureError::Memory { path: self.path.clone(), frame_mib, max_mib: self.config.max_mib });
        }
        self.capacity = self.config.max_frames.min(fitting);
        self.fit = Some(fit);
        Ok(())
    }

    /// Keeps every second frame of those at the present stride.
    fn thin(&mut self) {
        self.stride *= 2;
        let keep: Vec<bool> = self.indices.iter().map(|i| i % self.stride == 0).collect();
        let mut flags = keep.iter();
        self.frames.retain(|_| flags.next().copied().unwrap_or(false));
        self.indices.retain(|i| i % self.stride == 0);
        self.black.retain(|i| i % self.stride == 0);
    }

    pub(super) fn finish(mut self, kind: ClipKind, fps: Option<f64>) -> Result<Clip, CaptureError> {
        let path = self.path;
        match self.seen {
            0 => return Err(CaptureError::NoFrames { path }),
            1 => return Err(CaptureError::OneFrame { path }),
            _ => {}
        }
        let looked_at = self.seen.div_ceil(self.stride);
        if 2 * self.black.len() >= looked_at || self.frames.len() < 2 {
            return Err(CaptureError::Black { path, black: self.black.len(), frames: looked_at });
        }
        if !self.black.is_empty() {
            self.notes.push(format!("{} black frames left out: {:?}", self.black.len(), self.black));
        }
        if self.stride > 1 {
            self.notes.push(format!("{} frames in the source; every {}. is used", self.seen, self.stride));
        }
        let fov_deg = match (self.lens, self.source_size, &self.fit) {
            (Some(lens), Some([width, height]), Some(fit)) => lens.fov_deg([width, height], fit.window[2]),
            _ => None,
        };
        Ok(Clip { frames: self.frames, indices: self.indices, source: path, kind, fps, fov_deg, notes: self.notes })
    }
}

/// Light of every integer up to `max`, for values encoded with the display gamma.
pub(super) fn light_table(max: usize) -> Vec<f32> {
    (0..=max).map(|i| ops::colour::gamma_decode(i as f32 / max as f32)).collect()
}
