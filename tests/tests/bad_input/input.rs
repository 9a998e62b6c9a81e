//! Making the input of a case.

use std::path::PathBuf;
use std::process::Command;

use dataset::image_io::{Overwrite, write_png8};
use ops::planes::Planes;

use crate::case::Place;

/// Side of the frames, in pixels: the smallest that are accepted.
pub const SIDE: usize = 64;

/// A frame full of detail, different for every seed.
pub fn detail(seed: u32) -> Planes {
    let mut planes = Planes::new(3, SIDE, SIDE);
    for (i, value) in (0u32..).zip(&mut planes.data) {
        // Two rounds of a multiplicative hash: any fixed pattern without a period would do.
        let mixed = (i ^ seed.wrapping_mul(0x9e37_79b9)).wrapping_mul(0x85eb_ca6b);
        let mixed = (mixed ^ (mixed >> 13)).wrapping_mul(0xc2b2_ae35);
        *value = (mixed >> 8) as f32 / (1u32 << 24) as f32;
    }
    planes
}

/// A frame of one grey.
pub fn grey(value: f32) -> Planes {
    Planes::constant(SIDE, SIDE, &[value; 3])
}

impl Place<'_> {
    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    pub fn file(&self, name: &str, bytes: impl AsRef<[u8]>) {
        let path = self.path(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, bytes).unwrap();
    }

    pub fn empty_folder(&self, name: &str) {
        std::fs::create_dir_all(self.path(name)).unwrap();
    }

    /// A folder `clip` of frames.
    pub fn clip(&self, frames: &[Planes]) {
        self.empty_folder("clip");
        for (i, frame) in frames.iter().enumerate() {
            write_png8(&self.path(&format!("clip/{i:03}.png")), frame, Overwrite::Refuse).unwrap();
        }
    }

    /// A clip that can be aligned: a window that moves over a smooth pattern.
    pub fn good_clip(&self) {
        let pattern = detail(5).resize_area(SIDE / 2, SIDE / 2).resize_bilinear(2 * SIDE, 2 * SIDE);
        let frames: Vec<Planes> = (0..8).map(|i| pattern.crop(3 * i, 2 * i, SIDE, SIDE)).collect();
        self.clip(&frames);
    }

    /// A NumPy array with the given header and data.
    pub fn npy(&self, name: &str, kind: &str, shape: &[usize], data: &[u8]) {
        let shape: String = shape.iter().map(|n| format!("{n}, ")).collect();
        let header = format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': ({shape}), }}\n");
        let length = u16::try_from(header.len()).unwrap().to_le_bytes();
        self.file(name, [b"\x93NUMPY\x01\x00", &length[..], header.as_bytes(), data].concat());
    }

    /// A short video or sound file made by ffmpeg from one of its test sources.
    pub fn ffmpeg(&self, source: &str, name: &str) {
        let mut command = Command::new("ffmpeg");
        command.args(["-v", "error", "-f", "lavfi", "-i", source]).arg(self.path(name));
        let output = command.output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    }

    pub fn cut_in_half(&self, name: &str) {
        let bytes = std::fs::read(self.path(name)).unwrap();
        self.file(name, &bytes[..bytes.len() / 2]);
    }

    /// A folder `broken` with a copy of the good weights.
    pub fn copy_weights(&self) {
        self.empty_folder("broken");
        for entry in std::fs::read_dir(self.weights).unwrap() {
            let entry = entry.unwrap();
            std::fs::copy(entry.path(), self.path("broken").join(entry.file_name())).unwrap();
        }
    }

    /// The manifest of `broken` with one text replaced by another.
    pub fn edit_manifest(&self, from: &str, to: &str) {
        let text = std::fs::read_to_string(self.path("broken/manifest.json")).unwrap();
        assert!(text.contains(from), "{text}");
        self.file("broken/manifest.json", text.replace(from, to));
    }

    /// The folder `locked`, which may be read but not written to.
    pub fn locked_folder(&self) {
        self.empty_folder("locked");
        let mut permissions = std::fs::metadata(self.path("locked")).unwrap().permissions();
        permissions.set_readonly(true);
        std::fs::set_permissions(self.path("locked"), permissions).unwrap();
    }

    /// Whether permissions don't bind this user (root).
    pub fn can_write_everywhere(&self) -> bool {
        self.locked_folder();
        let trial = self.path("locked/trial");
        let written = std::fs::write(&trial, "").is_ok();
        if written {
            std::fs::remove_file(trial).unwrap();
        }
        std::fs::remove_dir(self.path("locked")).unwrap();
        written
    }
}
