//! The frozen split into training and test materials.
//!
//! The side is decided by a hash of the material's *identity*: what was scanned, whatever its colour, size or file format.
//! It depends on nothing else, so it is the same in every run, and a material that is added later moves no other.

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

/// Share of the identities that are kept for tests.
///
/// # Units
/// Per cent.
pub const TEST_PERCENT: u64 = 20;

/// Names the split; another name would be another split, and figures of different splits don't compare.
const DOMAIN: &[u8] = b"deep reflectance scanning, split 1";

/// A side of the split.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Split {
    /// Nets may learn from these.
    Train,
    /// Figures are measured on these; no net has seen them.
    Test,
}

impl std::fmt::Display for Split {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Train => "train",
            Self::Test => "test",
        })
    }
}

/// The side of an identity.
pub fn split_of(identity: &str) -> Split {
    let mut hash = Sha256::new();
    hash.update(DOMAIN);
    hash.update(identity.as_bytes());
    let digest = hash.finalize();
    let number = u64::from_le_bytes(std::array::from_fn(|i| digest[i]));
    if number % 100 < TEST_PERCENT { Split::Test } else { Split::Train }
}

/// Words that name a colour or a version of a scan rather than the scan.
const COLOURS: &[&str] = &[
    "amber", "beige", "black", "blue", "brown", "cream", "cyan", "dark", "gold", "gray", "green", "grey", "light", "orange",
    "pink", "purple", "red", "silver", "tan", "teal", "violet", "white", "yellow",
];
const FORMATS: &[&str] = &["jpg", "jpeg", "png", "exr", "tif", "tiff", "webp"];
const VARIANTS: &[&str] = &["col", "color", "colour", "var", "variant", "variation"];

/// The identity of a scan from its folder's name.
///
/// Dropped are resolutions (`2K`), file formats, colour words, numbered colour variants (`col_02`), and the letter that
/// ambientCG puts after the number of a recoloured scan (`Bricks075B`).
pub fn identity_of_scan(name: &str) -> String {
    let lower = name.to_lowercase();
    let words: Vec<&str> = lower.split(|c: char| !c.is_alphanumeric()).filter(|w| !w.is_empty()).collect();
    let mut kept: Vec<&str> = Vec::new();
    for (i, word) in words.iter().enumerate() {
        let numbered_variant = is_number(word) && i > 0 && VARIANTS.contains(&words[i - 1]);
        if !(is_size(word) || FORMATS.contains(word) || COLOURS.contains(word) || VARIANTS.contains(word) || numbered_variant) {
            kept.push(without_variant_letter(word));
        }
    }
    if kept.is_empty() { lower } else { kept.join("_") }
}

/// The identity of a material from the name of the file that holds it, without the extension.
///
/// Before [`identity_of_scan`], which makes it the identity of a folder with the same scan, these are dropped: sizes in
/// texels (`NAME_1024`), and the numbering and the crop of the set of Deschaintre et al. (`0000237;NAME;2X3`), so that all
/// crops of a material stay on one side. A strip there that blends two materials goes by both names together; its parents
/// may lie on the other side.
pub fn identity_of_file(name: &str) -> String {
    let lower = name.to_lowercase();
    let fields: Vec<&str> = lower.split(';').collect();
    let is_scan = |field: &&str| fields.len() == 1 || !(is_number(field) || is_crop(field));
    let scan = fields.iter().copied().filter(is_scan).collect::<Vec<_>>().join("_");
    let words = scan.split(|c: char| !c.is_alphanumeric()).filter(|word| !is_texels(word));
    let kept = words.collect::<Vec<_>>().join("_");
    identity_of_scan(if kept.is_empty() { name } else { &kept })
}

/// `2x3`: a crop and how it was turned.
fn is_crop(field: &str) -> bool {
    field.split_once('x').is_some_and(|(crop, _)| !crop.is_empty() && is_number(crop))
}

/// `1024`, `1024x1024`.
fn is_texels(word: &str) -> bool {
    word.split('x').all(|side| ["256", "512", "1024", "2048", "4096", "8192"].contains(&side))
}

fn is_number(word: &str) -> bool {
    word.bytes().all(|b| b.is_ascii_digit())
}

/// `1k`, `16k`.
pub(super) fn is_size(word: &str) -> bool {
    word.strip_suffix(['k', 'K']).is_some_and(|digits| !digits.is_empty() && digits.len() <= 2 && is_number(digits))
}

fn without_variant_letter(word: &str) -> &str {
    let Some(body) = word.strip_suffix(|c: char| c.is_ascii_alphabetic()) else { return word };
    let digits = body.bytes().rev().take_while(u8::is_ascii_digit).count();
    if digits >= 2 && digits < body.len() { body } else { word }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_scan_has_one_identity() {
        for (a, b) in [
            ("Bricks075B", "Bricks075A_2K-PNG"),
            ("Metal048A", "Metal048C_1K-JPG"),
            ("red_bricks_04", "white_bricks_04_4k"),
            ("fabric_pattern_05_col_01", "Fabric Pattern 05 col 2"),
            ("leather_white", "leather_red"),
        ] {
            assert_eq!(identity_of_scan(a), identity_of_scan(b), "{a} {b}");
        }
        for (a, b) in [("red_bricks_04", "red_bricks_03"), ("Metal048A", "Metal049A"), ("wood_floor", "wood_table")] {
            assert_ne!(identity_of_scan(a), identity_of_scan(b), "{a} {b}");
        }
        assert_eq!(identity_of_scan("red"), "red");
        assert_eq!(identity_of_scan(""), "");
    }

    #[test]
    fn files_of_one_scan_have_the_identity_of_its_folder() {
        for (file, folder) in [
            ("Bricks075B_1024", "Bricks075A_2K-PNG"),
            ("red_bricks_04_4096x4096", "white_bricks_04"),
            ("0000237;leather_antiqueXwood_02;2X3", "leather_antiqueXwood_02"),
            ("0000911;leather_antiqueXwood_02;0XDefault", "leather_antiqueXwood_02"),
        ] {
            assert_eq!(identity_of_file(file), identity_of_scan(folder), "{file}");
        }
        let numbered = ["0001", "0002", "1024", "1024;2X3", "0000001;wood;1X2", "0000001;stone;1X2", ";;"];
        let mut identities = numbered.map(identity_of_file).to_vec();
        identities.sort();
        identities.dedup();
        assert_eq!(identities.len(), numbered.len(), "{identities:?}");
        assert_eq!(identity_of_file(""), "");
    }

    #[test]
    fn the_split_is_frozen_and_has_the_stated_share() {
        let test = (0..10_000).filter(|i| split_of(&format!("material {i}")) == Split::Test).count();
        assert!((1_850..2_150).contains(&test), "{test}");
        let sides: String =
            ["bricks075", "metal030", "red_bricks", "wood092", "marble006", "tiles036", "stone_floor", "onyx013"]
                .map(|n| if split_of(n) == Split::Test { 'T' } else { '.' })
                .iter()
                .collect();
        assert_eq!(sides, FROZEN);
    }

    /// From Python: `int.from_bytes(sha256(DOMAIN + name).digest()[:8], 'little') % 100 < 20`.
    const FROZEN: &str = ".T..T.T.";
}
