//! A net's parameters as named, flat tensors.
//!
//! burn identifies parameters by random numbers; checkpoints, moments and averages need names that the next process
//! finds again, so everything here goes by the path of a parameter in its module tree.

use burn::module::{Module, ModuleMapper, ModuleVisitor, Param};
use burn::tensor::{Device, Tensor, TensorData};
use std::collections::BTreeMap;

/// Tensors by name, each flattened, none of them tracked by autodiff.
pub type NamedTensors = BTreeMap<String, Tensor<1>>;

/// Stored values that don't belong to the net they are given to.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ParameterError {
    /// The net has a parameter that isn't stored.
    #[error("the net's parameter `{name}` is missing")]
    Missing {
        /// Path of the parameter.
        name: String,
    },
    /// A stored parameter has no place in the net.
    #[error("there is a value for `{name}`, which the net doesn't have")]
    Foreign {
        /// Path of the parameter.
        name: String,
    },
    /// Both have it, in different sizes.
    #[error("the parameter `{name}` has {found} values, the net's has {expected}")]
    Size {
        /// Path of the parameter.
        name: String,
        /// Stored values.
        found: usize,
        /// Values of the net.
        expected: usize,
    },
}

/// The path of the module that a traversal stands in.
#[derive(Default)]
struct Path(Vec<String>);

impl Path {
    fn name(&self) -> String {
        self.0.join(".")
    }
}

struct Reader<F> {
    path: Path,
    take: F,
}

/// What is done with one parameter; a trait because closures can't be generic over the rank.
trait Take {
    fn take<const D: usize>(&mut self, name: String, tensor: Tensor<D>);
}

impl<F: Take> ModuleVisitor for Reader<F> {
    fn enter_module(&mut self, name: &str, _container: &str) {
        self.path.0.push(name.to_string());
    }

    fn exit_module(&mut self, _name: &str, _container: &str) {
        self.path.0.pop();
    }

    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        self.take.take(self.path.name(), param.val());
    }
}

struct TakeValues(NamedTensors);

impl Take for TakeValues {
    fn take<const D: usize>(&mut self, name: String, tensor: Tensor<D>) {
        self.0.insert(name, flat(tensor.inner()));
    }
}

/// The values of all parameters.
pub fn values<M: Module>(net: &M) -> NamedTensors {
    let mut reader = Reader { path: Path::default(), take: TakeValues(NamedTensors::new()) };
    net.visit(&mut reader);
    reader.take.0
}

/// The gradients of a step by parameter name.
#[derive(Default)]
pub struct Gradients(pub NamedTensors);

struct TakeGradients<'a> {
    all: &'a mut burn::tensor::Gradients,
    named: NamedTensors,
}

impl Take for TakeGradients<'_> {
    fn take<const D: usize>(&mut self, name: String, tensor: Tensor<D>) {
        if let Some(gradient) = tensor.grad_remove(self.all) {
            self.named.insert(name, flat(gradient));
        }
    }
}

/// Takes the gradients of a net's parameters out of a backward pass.
pub fn gradients<M: Module>(net: &M, mut all: burn::tensor::Gradients) -> Gradients {
    let mut reader = Reader { path: Path::default(), take: TakeGradients { all: &mut all, named: NamedTensors::new() } };
    net.visit(&mut reader);
    Gradients(reader.take.named)
}

impl Gradients {
    /// Adds the gradients of another batch.
    pub fn add(&mut self, other: Self) {
        for (name, gradient) in other.0 {
            let sum = match self.0.remove(&name) {
                Some(so_far) => so_far + gradient,
                None => gradient,
            };
            self.0.insert(name, sum);
        }
    }

    /// Multiplies every gradient.
    pub fn scale(&mut self, factor: f64) {
        for gradient in self.0.values_mut() {
            *gradient = gradient.clone().mul_scalar(factor);
        }
    }

    /// The norm of the gradient as one long vector; NaN or infinite when any of its values is.
    pub fn norm(&self) -> f32 {
        let squares: Vec<Tensor<1>> = self.0.values().map(|gradient| gradient.clone().square().sum()).collect();
        if squares.is_empty() {
            return 0.0;
        }
        // One read for all parameters: on a GPU every read is a round trip.
        let squares = Tensor::cat(squares, 0).into_data().convert::<f32>();
        squares.iter::<f32>().map(f64::from).sum::<f64>().sqrt() as f32
    }

    /// Shortens the gradient to the norm `limit` when it is longer; `norm` is its present norm.
    pub fn clip(&mut self, norm: f32, limit: f64) {
        if limit > 0.0 && f64::from(norm) > limit {
            self.scale(limit / f64::from(norm));
        }
    }
}

struct Writer<'a> {
    path: Path,
    values: &'a NamedTensors,
    used: usize,
    error: Option<ParameterError>,
}

impl ModuleMapper for Writer<'_> {
    fn enter_module(&mut self, name: &str, _container: &str) {
        self.path.0.push(name.to_string());
    }

    fn exit_module(&mut self, _name: &str, _container: &str) {
        self.path.0.pop();
    }

    fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
        let name = self.path.name();
        let Some(value) = self.values.get(&name) else {
            self.error.get_or_insert(ParameterError::Missing { name });
            return param;
        };
        let (found, expected) = (value.dims()[0], param.val().shape().num_elements());
        if found != expected {
            self.error.get_or_insert(ParameterError::Size { name, found, expected });
            return param;
        }
        self.used += 1;
        let (id, old, mapper) = param.consume();
        let mut new = value.clone().reshape(old.shape());
        if old.is_autodiff() {
            new = Tensor::from_inner(new);
            if let Some(strategy) = old.gradient_checkpointing_strategy() {
                new = new.with_gradient_checkpointing_strategy(strategy);
            }
            new = new.set_require_grad(old.is_require_grad());
        }
        Param::from_mapped_value(id, new, mapper)
    }
}

/// Puts values into a net, all of them and no others.
///
/// # Errors
/// A parameter that is missing, foreign or of another size; the net is lost then.
pub fn assign<M: Module>(net: M, values: &NamedTensors) -> Result<M, ParameterError> {
    let mut writer = Writer { path: Path::default(), values, used: 0, error: None };
    let known = self::values(&net);
    let net = net.map(&mut writer);
    match writer.error {
        Some(error) => Err(error),
        None if writer.used != values.len() => {
            let name = values.keys().find(|name| !known.contains_key(*name)).cloned().unwrap_or_default();
            Err(ParameterError::Foreign { name })
        }
        None => Ok(net),
    }
}

fn flat<const D: usize>(tensor: Tensor<D>) -> Tensor<1> {
    let count = tensor.shape().num_elements();
    tensor.reshape([count])
}

/// The first parameter, in the order of names, that holds a value that isn't finite, with that value.
pub fn first_non_finite(tensors: &NamedTensors) -> Option<(String, f32)> {
    tensors.iter().find_map(|(name, tensor)| Some((name.clone(), to_vec(tensor).into_iter().find(|value| !value.is_finite())?)))
}

/// A tensor's values on the CPU.
pub(crate) fn to_vec(tensor: &Tensor<1>) -> Vec<f32> {
    tensor.to_data().convert::<f32>().iter::<f32>().collect()
}

/// A flat tensor on a device.
pub(crate) fn from_vec(values: Vec<f32>, device: &Device) -> Tensor<1> {
    let count = values.len();
    Tensor::from_data(TensorData::new(values, [count]), device)
}
