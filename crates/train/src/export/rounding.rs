//! What weights lose when they are stored with fewer bits, in themselves and in what the net answers.

use std::collections::BTreeMap;

use burn::tensor::Tensor;
use ops::planes::values;
use ops::weights::{NetRecord, Precision, Tensors};

use super::examples::SIDE;

/// Differences between a net and its rounded version.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rounding {
    /// Of the weights, mean.
    pub weight_mean: f64,
    /// Of the weights, largest.
    pub weight_largest: f64,
    /// Of the output on the example, mean: of flows the distance in pixels, of maps the difference of their numbers.
    pub output_mean: f64,
    /// The same, largest.
    pub output_largest: f64,
}

impl Rounding {
    /// Compares weights, and outputs `[N, C, H, W]` for the same input.
    pub fn between(exact: &Tensors, rounded: &Tensors, output: &Tensor<4>, rounded_output: &Tensor<4>) -> Self {
        let weights = exact
            .iter()
            .flat_map(|(name, tensor)| tensor.values.iter().zip(&rounded[name].values).map(|(a, b)| f64::from((a - b).abs())));
        let (weight_mean, weight_largest) = mean_and_largest(weights);
        let difference = output.clone() - rounded_output.clone();
        let [_, channels, ..] = difference.dims();
        let difference = if channels == 2 { difference.powi_scalar(2).sum_dim(1).sqrt() } else { difference.abs() };
        let (output_mean, output_largest) = mean_and_largest(values(difference).into_iter().map(f64::from));
        Self { weight_mean, weight_largest, output_mean, output_largest }
    }

    /// Figures for the manifest; none for weights that are stored exactly.
    pub fn figures(&self, kind: &str, precision: Precision) -> BTreeMap<String, f64> {
        if precision == Precision::F32 {
            return BTreeMap::new();
        }
        let output = if kind == flow::weights::KIND { "rounding_epe_px" } else { "rounding_maps_l1" };
        let figures = [
            ("rounding_weight_mean", self.weight_mean),
            ("rounding_weight_largest", self.weight_largest),
            (output, self.output_mean),
            (&format!("{output}_largest"), self.output_largest),
        ];
        figures.map(|(name, value)| (name.to_string(), value)).into()
    }

    /// The loss in plain words.
    pub fn words(&self, record: &NetRecord) -> String {
        if record.precision == Precision::F32 {
            return "stored exactly".into();
        }
        let Self { weight_mean, weight_largest, output_mean, output_largest } = self;
        let weights = format!("rounding moves a weight by {weight_mean:.1e} on average, {weight_largest:.1e} at most");
        let reached = |name: &str| record.metrics.get(name).copied();
        if record.kind == flow::weights::KIND {
            let own = reached("epe_px").map_or_else(String::new, |epe| format!("; the net's own error is {epe:.2} px"));
            return format!(
                "{weights}; on a generated pair of {SIDE} × {SIDE} px the flow moves by {output_mean:.4} px on average, {output_largest:.3} px at most{own}"
            );
        }
        let errors = ["diffuse_l1", "specular_l1", "roughness_l1", "normal_l1"].map(reached);
        let own = match errors {
            [Some(diffuse), Some(specular), Some(roughness), Some(normal)] => format!(
                "; the net's own errors are {diffuse:.3} (diffuse), {specular:.3} (specular), {roughness:.3} (roughness), {normal:.3} (normals)"
            ),
            _ => String::new(),
        };
        format!(
            "{weights}; on a generated scan of {SIDE} × {SIDE} px the maps change by {output_mean:.5} on average, {output_largest:.4} at most{own}"
        )
    }
}

fn mean_and_largest(differences: impl Iterator<Item = f64>) -> (f64, f64) {
    let (mut sum, mut count, mut largest) = (0.0, 0usize, 0.0f64);
    for difference in differences {
        sum += difference;
        count += 1;
        largest = largest.max(difference);
    }
    (sum / count.max(1) as f64, largest)
}

#[cfg(test)]
mod tests {
    use super::*;
    use burn::tensor::Device;
    use ops::weights::StoredTensor;

    fn weights(values: [f32; 2]) -> Tensors {
        Tensors::from([("a".to_string(), StoredTensor { shape: vec![2], values: values.to_vec() })])
    }

    #[test]
    fn flows_differ_by_distance_and_maps_by_value() {
        let device = Device::flex();
        let between =
            |exact: Tensor<4>, rounded| Rounding::between(&weights([1.0, 2.0]), &weights([1.0, 2.5]), &exact, &rounded);
        let flow = between(
            Tensor::from_data([[[[0.0, 1.0]], [[0.0, 1.0]]]], &device),
            Tensor::from_data([[[[3.0, 1.0]], [[4.0, 1.0]]]], &device),
        );
        assert_eq!((flow.weight_mean, flow.weight_largest, flow.output_mean, flow.output_largest), (0.25, 0.5, 2.5, 5.0));
        let maps = between(Tensor::zeros([1, 10, 1, 1], &device), Tensor::full([1, 10, 1, 1], 0.5, &device));
        assert_eq!((maps.output_mean, maps.output_largest), (0.5, 0.5));
        assert!(maps.figures("svbrdf", Precision::F32).is_empty());
        assert_eq!(maps.figures("svbrdf", Precision::F16)["rounding_maps_l1"], 0.5);
        assert_eq!(flow.figures("pwc", Precision::Bf16)["rounding_epe_px_largest"], 5.0);
    }
}
