//! Maps on disk beside the truth: how good one scan became.

use std::path::Path;

use render::svbrdf::SvbrdfImage;
use scan::export::maps::read_exr;
use svbrdf::constants::ConstantMaps;

use crate::EvaluateError;
use crate::synthetic::Errors;

/// Maps of a scan and the true ones, of one size.
pub struct ScannedMaps {
    maps: SvbrdfImage,
    truth: SvbrdfImage,
}

/// Errors of one set of maps and of constant maps against the same truth.
pub struct Comparison {
    /// The maps' errors.
    pub found: Errors,
    /// Those of the constant maps.
    pub constant: Errors,
}

impl ScannedMaps {
    /// Reads the maps that `scan` wrote and the truth.
    ///
    /// # Errors
    /// If either folder lacks a map, or their sizes differ.
    pub fn read(maps_folder: &Path, truth_folder: &Path) -> Result<Self, EvaluateError> {
        let (maps, truth) = (read_exr(maps_folder)?, read_exr(truth_folder)?);
        let size = |maps: &SvbrdfImage| (maps.height(), maps.width());
        if size(&maps) != size(&truth) {
            let name = |folder: &Path, (height, width)| format!("{} ({height}×{width})", folder.display());
            return Err(EvaluateError::Sizes { maps: name(maps_folder, size(&maps)), truth: name(truth_folder, size(&truth)) });
        }
        Ok(Self { maps, truth })
    }

    /// Their errors beside those of constant maps.
    pub fn compare(&self, constants: &ConstantMaps) -> Comparison {
        let constant = constants.to_image(self.truth.height(), self.truth.width());
        Comparison { found: Errors::between(&self.maps, &self.truth), constant: Errors::between(&constant, &self.truth) }
    }
}

impl Comparison {
    /// Name, error and constant maps' error of every figure; those that a small image lacks are left out.
    pub fn figures(&self) -> Vec<(&'static str, f64, f64)> {
        let of = |Errors { maps, render, spikes }: &Errors| {
            [
                ("diffuse L1", Some(maps.diffuse_l1)),
                ("specular L1", Some(maps.specular_l1)),
                ("roughness L1", Some(maps.roughness_l1)),
                ("normal L1", Some(maps.normal_l1)),
                ("normal, degrees", Some(maps.normal_deg)),
                ("re-rendering L1", Some(render.l1)),
                ("re-rendering DSSIM", render.dssim),
                ("spikes, share of pixels", Some(spikes.share())),
                ("spikes, mean excess", Some(spikes.excess)),
            ]
        };
        let pairs = of(&self.found).into_iter().zip(of(&self.constant));
        pairs.filter_map(|((name, found), (_, constant))| Some((name, found?, constant?))).collect()
    }

    /// The figures as a Markdown table; without a ratio where constant maps have no error (they have no spikes).
    pub fn markdown(&self) -> String {
        let mut text = String::from("| error | maps | constant maps | ratio |\n|---|---|---|---|\n");
        for (name, found, constant) in self.figures() {
            let ratio = if constant > 0.0 { format!("{:.3}", found / constant) } else { "–".into() };
            text += &format!("| {name} | {found:.4} | {constant:.4} | {ratio} |\n");
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use render::texel::Texel;
    use scan::export::maps::write_truth;

    fn constants() -> ConstantMaps {
        ConstantMaps { diffuse: [0.2; 3], roughness: 0.5, specular: [0.04; 3] }
    }

    fn folder(side: usize, diffuse: f32) -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        let texel = Texel { normal: [0.0, 0.0, 1.0], diffuse: [diffuse; 3], roughness: 0.3, specular: [0.04; 3] };
        write_truth(folder.path(), &SvbrdfImage::constant(side, side, &texel)).unwrap();
        folder
    }

    #[test]
    fn errors_stand_beside_those_of_constant_maps() {
        let (maps, truth) = (folder(16, 0.5), folder(16, 0.6));
        let comparison = ScannedMaps::read(maps.path(), truth.path()).unwrap().compare(&constants());
        let figures = comparison.figures();
        let figure = |name: &str| figures.iter().find(|f| f.0 == name).map(|f| (f.1, f.2)).unwrap();
        let near = |a: (f64, f64), b: (f64, f64)| (a.0 - b.0).abs() < 1e-6 && (a.1 - b.1).abs() < 1e-6;
        assert!(near(figure("diffuse L1"), (0.1, 0.4)), "{:?}", figure("diffuse L1"));
        assert!(near(figure("roughness L1"), (0.0, 0.2)));
        assert!(figure("re-rendering L1").0 < figure("re-rendering L1").1);
        assert!(comparison.markdown().contains("| diffuse L1 | 0.1000 | 0.4000 | 0.250 |"));
        assert!(comparison.markdown().contains("| spikes, share of pixels | 0.0000 | 0.0000 | – |"));
    }

    #[test]
    fn maps_of_another_size_are_refused() {
        let error = ScannedMaps::read(folder(16, 0.5).path(), folder(32, 0.5).path()).err().unwrap().to_string();
        assert!(error.contains("16×16") && error.contains("32×32") && error.contains("--resolution"), "{error}");
    }
}
