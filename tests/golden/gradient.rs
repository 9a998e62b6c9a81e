//! Every parameter's gradient beside the twin's, by name; large ones by their sketch (see `generate/golden.py`).

use std::collections::BTreeMap;

use burn::module::{Module, ModuleVisitor, Param};
use burn::tensor::{Gradients, Tensor, TensorData};
use ops::planes::values;

use crate::case::{Case, relative_norm};

/// A gradient of more values than this is compared by its sketch.
const LARGEST_WHOLE: usize = 256;
const BUCKETS: usize = 64;

/// +1 or −1 by a multiplicative hash of the index.
fn sign(index: usize) -> f32 {
    let hashed = (index as u64 * 2_654_435_761) & 0xFFFF_FFFF;
    if hashed >> 31 == 1 { -1.0 } else { 1.0 }
}

/// Σ sign(i)·x_i over a tensor's values: what both sides differentiate where there is no loss.
#[allow(dead_code, reason = "only some tests differentiate it")]
pub fn signed_sum(x: Tensor<4>) -> Tensor<1> {
    let shape = x.dims();
    let signs: Vec<f32> = (0..shape.iter().product()).map(sign).collect();
    let signs = Tensor::from_data(TensorData::new(signs, shape), &x.device());
    (x * signs).sum()
}

/// Values as the twin stores them: signed sums over every `BUCKETS`-th where there are many.
pub fn sketch(values: Vec<f32>) -> Vec<f32> {
    if values.len() <= LARGEST_WHOLE {
        return values;
    }
    let mut sums = vec![0.0f64; BUCKETS];
    for (i, value) in values.iter().enumerate() {
        sums[i % BUCKETS] += f64::from(sign(i) * value);
    }
    sums.into_iter().map(|s| s as f32).collect()
}

#[allow(dead_code, reason = "see `errors`")]
struct ByName<'a> {
    path: Vec<String>,
    gradients: &'a Gradients,
    found: BTreeMap<String, Vec<f32>>,
}

impl ModuleVisitor for ByName<'_> {
    fn enter_module(&mut self, name: &str, _container: &str) {
        self.path.push(name.into());
    }

    fn exit_module(&mut self, _name: &str, _container: &str) {
        self.path.pop();
    }

    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        let count = param.lazy_shape().num_elements();
        // A parameter that the result doesn't depend on has no gradient: that is, 0.
        let gradient = param.val().grad(self.gradients).map_or_else(|| vec![0.0; count], values);
        self.found.insert(self.path.join("."), gradient);
    }
}

/// The relative error of every parameter's gradient, worst first. The twin's are named `prefix.parameter`.
#[allow(dead_code, reason = "the optimiser's test compares ways, not gradients")]
pub fn errors<M: Module>(net: &M, gradients: &Gradients, case: &Case, prefix: &str) -> Vec<(f64, String)> {
    let mut visitor = ByName { path: Vec::new(), gradients, found: BTreeMap::new() };
    net.visit(&mut visitor);
    let compare = |(name, gradient): (String, Vec<f32>)| {
        (relative_norm(&sketch(gradient), case.values(&format!("{prefix}.{name}"))), name)
    };
    let mut errors: Vec<(f64, String)> = visitor.found.into_iter().map(compare).collect();
    errors.sort_by(|a, b| b.0.total_cmp(&a.0));
    errors
}
