//! What can be wrong with a clip.

use std::path::PathBuf;

use crate::image_io::ImageError;

/// A clip that can't be used: what was found, what was expected, what to try.
#[derive(Debug, thiserror::Error)]
pub enum CaptureError {
    /// A value of the config.
    #[error("capture: {key} is {found}; expected {expected}")]
    Config {
        /// Name of the value.
        key: &'static str,
        /// What it is.
        found: usize,
        /// What it may be.
        expected: &'static str,
    },
    /// Nothing there.
    #[error("{path}: no such file or folder")]
    Missing {
        /// The clip.
        path: PathBuf,
    },
    /// Zero bytes.
    #[error("{path}: the file is empty; copy it from the camera again")]
    Empty {
        /// The clip.
        path: PathBuf,
    },
    /// The system refused.
    #[error("{path}: can't be read: {source}")]
    Read {
        /// The clip.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// No ffmpeg.
    #[error(
        "{path}: reading a video needs `{program}`, which isn't on the PATH. Install it (Debian, Ubuntu: `apt install ffmpeg`; \
         macOS: `brew install ffmpeg`), or extract the frames elsewhere and give a folder of PNG or JPEG files"
    )]
    NoFfmpeg {
        /// The clip.
        path: PathBuf,
        /// `ffmpeg` or `ffprobe`.
        program: String,
    },
    /// Not something ffmpeg can decode.
    #[error("{path}: not a video that ffmpeg understands ({reason}); expected a video, a folder of frames or a .npy array")]
    NotAVideo {
        /// The clip.
        path: PathBuf,
        /// ffmpeg's words.
        reason: String,
    },
    /// Sound only, or subtitles.
    #[error("{path}: the file has no video stream; record the scan as a video")]
    NoVideoStream {
        /// The clip.
        path: PathBuf,
    },
    /// The end is missing.
    #[error("{path}: the file is truncated ({reason}); copy it from the camera again")]
    Truncated {
        /// The clip.
        path: PathBuf,
        /// What shows it.
        reason: String,
    },
    /// Decoding failed.
    #[error("{path}: ffmpeg gave up after {frames} frames: {reason}")]
    Broken {
        /// The clip.
        path: PathBuf,
        /// Frames decoded before.
        frames: usize,
        /// ffmpeg's words.
        reason: String,
    },
    /// A picture instead of a clip, or a clip of one frame.
    #[error(
        "{path}: a single frame; a scan needs at least 2 frames that overlap, better 100 (give a video or a folder of frames)"
    )]
    OneFrame {
        /// The clip.
        path: PathBuf,
    },
    /// No frame at all.
    #[error("{path}: no frame in it; expected PNG, JPEG or EXR files in a folder, or frames in a video or array")]
    NoFrames {
        /// The clip.
        path: PathBuf,
    },
    /// Frames of different sizes.
    #[error("{path}: frame {frame} has {}×{} pixels, the first has {}×{}; all frames must come from one camera setting",
        found[0], found[1], expected[0], expected[1])]
    Sizes {
        /// The clip, or the frame's file.
        path: PathBuf,
        /// The frame.
        frame: usize,
        /// Its columns and rows.
        found: [usize; 2],
        /// Columns and rows of the first frame.
        expected: [usize; 2],
    },
    /// Too few pixels.
    #[error("{path}: frames of {width}×{height} pixels; at least {min}×{min} are needed", min = super::MIN_SIDE)]
    TooSmall {
        /// The clip.
        path: PathBuf,
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
    },
    /// Not even two frames fit.
    #[error("{path}: one frame takes {frame_mib} MiB and {max_mib} MiB are allowed; lower the resolution or raise max_mib")]
    Memory {
        /// The clip.
        path: PathBuf,
        /// Size of one frame.
        frame_mib: usize,
        /// The limit.
        max_mib: usize,
    },
    /// No light.
    #[error("{path}: {black} of {frames} frames are black; scan with the flash on and nothing over the lens")]
    Black {
        /// The clip.
        path: PathBuf,
        /// Black frames.
        black: usize,
        /// All frames.
        frames: usize,
    },
    /// NaN or infinity.
    #[error("{path}: frame {frame} holds NaN or infinite values; export it again without such values")]
    NonFinite {
        /// The clip.
        path: PathBuf,
        /// The frame.
        frame: usize,
    },
    /// Float frames that aren't encoded in \[0, 1\].
    #[error("{path}: frame {frame} has values from {low} to {high}; float frames must be gamma-encoded within [0, 1]")]
    Range {
        /// The clip.
        path: PathBuf,
        /// The frame.
        frame: usize,
        /// Smallest value.
        low: f32,
        /// Largest value.
        high: f32,
    },
    /// An array of another kind.
    #[error("{path}: {reason}; expected a .npy array of uint8 or float32 with shape (frames, height, width, 3) in C order")]
    Npy {
        /// The clip.
        path: PathBuf,
        /// What was found.
        reason: String,
    },
    /// A frame's file.
    #[error(transparent)]
    Image(#[from] ImageError),
}
