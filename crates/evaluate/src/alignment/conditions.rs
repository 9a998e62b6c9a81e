//! The rows of the table: what each changes in the scans or in the aligner.

use crate::EvaluateError;

use super::AlignmentConfig;

/// A row of the table. Its settings are what a person would give as `--set` for a run of their own.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Condition {
    /// Name in files and on the command line.
    pub name: &'static str,
    /// What it is called in the table.
    pub title: &'static str,
    /// What it is a row of.
    pub group: Group,
    /// `KEY=VALUE` over [`AlignmentConfig`].
    pub settings: &'static [&'static str],
}

/// What a condition varies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Group {
    /// Nothing: the row that all others are compared with.
    Base,
    /// The scans (the paper's Table 5 and beyond).
    Scans,
    /// The aligner: one switch off.
    Ablation,
}

impl Group {
    fn name(self) -> &'static str {
        match self {
            Self::Base => "base",
            Self::Scans => "scans",
            Self::Ablation => "ablation",
        }
    }
}

const fn scans(name: &'static str, title: &'static str, settings: &'static [&'static str]) -> Condition {
    Condition { name, title, group: Group::Scans, settings }
}

const fn ablation(name: &'static str, title: &'static str, settings: &'static [&'static str]) -> Condition {
    Condition { name, title, group: Group::Ablation, settings }
}

/// All conditions, in the order of the table. Other frame rates keep the places of the key frames, as the paper does (at half
/// the rate as nearly as frames allow).
pub const CONDITIONS: [Condition; 36] = [
    Condition { name: "base", title: "as it is", group: Group::Base, settings: &[] },
    scans("rate-4", "frame rate ×4", &["videos.path.frame_rate=4.0", "align.key_frame_step=20"]),
    scans("rate-2", "frame rate ×2", &["videos.path.frame_rate=2.0", "align.key_frame_step=10"]),
    scans("rate-half", "frame rate ×0.5", &["videos.path.frame_rate=0.5", "align.key_frame_step=2"]),
    scans("deviations-0", "deviations ×0", &["videos.path.deviation_scale=0.0"]),
    scans("deviations-0.5", "deviations ×0.5", &["videos.path.deviation_scale=0.5"]),
    scans("deviations-1.5", "deviations ×1.5", &["videos.path.deviation_scale=1.5"]),
    scans("deviations-2", "deviations ×2", &["videos.path.deviation_scale=2.0"]),
    scans("zigzag", "zig-zag", &["videos.path.template=zigzag"]),
    scans("ambient-1", "environment light 1 %", &["videos.light.ambient=[0.01, 0.01]"]),
    scans("ambient-2", "environment light 2 %", &["videos.light.ambient=[0.02, 0.02]"]),
    scans("ambient-5", "environment light 5 %", &["videos.light.ambient=[0.05, 0.05]"]),
    scans("ambient-10", "environment light 10 %", &["videos.light.ambient=[0.1, 0.1]"]),
    scans("ambient-20", "environment light 20 %", &["videos.light.ambient=[0.2, 0.2]"]),
    scans("roll", "roll of 180° over the video", &["videos.path.roll_deg=180.0"]),
    scans("roll-fast", "roll of 720° over the video", &["videos.path.roll_deg=720.0"]),
    scans("compression", "compressed (JPEG 40–95)", &["videos.sensor={ compression = {} }"]),
    scans("h264", "H.264 at a phone's bit rate", &["encoding.codec=libx264"]),
    scans("distortion", "lens distortion", &["videos.sensor={ distortion = {} }"]),
    scans("rolling-shutter", "rolling shutter", &["videos.sensor={ rolling_shutter = {} }"]),
    scans("motion-blur", "motion blur", &["videos.sensor={ motion_blur = {} }"]),
    scans(
        "phone",
        "all sensor options",
        &[
            "videos.sensor={ vignetting = {}, exposure = {}, white_balance = {}, motion_blur = {}, distortion = {}, rolling_shutter = {}, compression = {} }",
        ],
    ),
    ablation("no-adjacent", "without the adjacent net", &["align.candidates.net=false"]),
    ablation("no-phase", "without phase correlation", &["align.candidates.phase_correlation=false"]),
    ablation("no-velocity", "without the neighbours' motion", &["align.candidates.velocity=false"]),
    ablation("no-identity", "without the guess of no motion", &["align.candidates.identity=false"]),
    ablation("no-photometric", "without refinement on the pixels", &["align.photometric.enabled=false"]),
    ablation("no-steady", "highlight not taken out", &["align.steady=false"]),
    ablation("no-distant", "without the distant net", &["align.distant=false"]),
    ablation("no-loops", "without loops", &["align.loops=false"]),
    ablation("no-adjust", "without joint adjustment", &["align.adjust=false"]),
    ablation("no-relief", "shading of relief not told from motion", &["align.relief=false"]),
    ablation("no-nets", "without both nets", &["align.candidates.net=false", "align.distant=false"]),
    ablation("chroma", "with chroma in the refinement", &["align.photometric.chroma=0.5"]),
    ablation("pnp", "the paper's chain, pose at 30°", &["align.regularise=pnp"]),
    ablation("none", "the paper's chain, not regularised", &["align.regularise=none"]),
];

impl Condition {
    /// The protocol's settings under this condition.
    ///
    /// # Errors
    /// If a setting doesn't fit.
    pub fn settings(&self, base: &AlignmentConfig) -> Result<AlignmentConfig, EvaluateError> {
        let settings: Vec<String> = self.settings.iter().map(ToString::to_string).collect();
        scan::settings::overlay(base, &settings).map_err(EvaluateError::Setting)
    }
}

/// The conditions of a comma-separated list of names and groups (`base`, `scans`, `ablation`, `all`), in the table's order.
///
/// # Errors
/// Names what is neither.
pub fn chosen(list: &str) -> Result<Vec<Condition>, EvaluateError> {
    let wanted: Vec<&str> = list.split(',').map(str::trim).collect();
    let matches = |c: &Condition, name: &str| name == "all" || name == c.name || name == c.group.name();
    if let Some(unknown) = wanted.iter().find(|w| !CONDITIONS.iter().any(|c| matches(c, w))) {
        return Err(EvaluateError::Condition { found: unknown.to_string() });
    }
    Ok(CONDITIONS.into_iter().filter(|c| wanted.iter().any(|w| matches(c, w))).collect())
}
