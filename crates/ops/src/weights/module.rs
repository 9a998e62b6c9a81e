//! From a module to named tensors and back.

use std::{collections::BTreeMap, path::Path};

use burn::{
    module::{Module, ModuleMapper, ModuleVisitor, Param},
    tensor::{Bool, Int, Tensor, TensorData},
};

use super::{StoredTensor, Tensors, WeightsError};

/// All parameters of a module by their path.
pub fn tensors_of<M: Module>(module: &M) -> Tensors {
    let mut collector = Collector::default();
    module.visit(&mut collector);
    collector.tensors
}

/// Fills a module with tensors; parameters keep their identity. `path` is the file that errors name.
///
/// # Errors
/// If there are other tensors than the module has parameters, or of other shapes.
pub fn fill<M: Module>(module: M, tensors: Tensors, path: &Path) -> Result<M, WeightsError> {
    let mut shapes = Shapes::default();
    module.visit(&mut shapes);
    for (tensor, expected) in &shapes.found {
        let Some(stored) = tensors.get(tensor) else {
            return Err(WeightsError::MissingTensor { path: path.into(), tensor: tensor.clone(), expected: expected.clone() });
        };
        if stored.shape != *expected {
            return Err(WeightsError::Shape {
                path: path.into(),
                tensor: tensor.clone(),
                expected: expected.clone(),
                found: stored.shape.clone(),
            });
        }
    }
    if let Some((tensor, stored)) = tensors.iter().find(|(name, _)| !shapes.found.contains_key(*name)) {
        let found = stored.shape.clone();
        return Err(WeightsError::UnexpectedTensor { path: path.into(), tensor: tensor.clone(), found });
    }
    Ok(module.map(&mut Filler { path: Vec::new(), tensors }))
}

/// Names, shapes and values of all parameters.
#[derive(Default)]
struct Collector {
    path: Vec<String>,
    tensors: Tensors,
}

impl ModuleVisitor for Collector {
    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        let tensor = param.val();
        let stored = StoredTensor { shape: tensor.dims().to_vec(), values: crate::planes::values(tensor) };
        self.tensors.insert(self.path.join("."), stored);
    }

    fn visit_int<const D: usize>(&mut self, _: &Param<Tensor<D, Int>>) {
        unreachable!("the nets have float parameters only: {}", self.path.join("."));
    }

    fn visit_bool<const D: usize>(&mut self, _: &Param<Tensor<D, Bool>>) {
        unreachable!("the nets have float parameters only: {}", self.path.join("."));
    }

    fn enter_module(&mut self, name: &str, _container: &str) {
        self.path.push(name.into());
    }

    fn exit_module(&mut self, _name: &str, _container: &str) {
        self.path.pop();
    }
}

/// Names and shapes of all parameters, without making lazy ones.
#[derive(Default)]
struct Shapes {
    path: Vec<String>,
    found: BTreeMap<String, Vec<usize>>,
}

impl ModuleVisitor for Shapes {
    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        self.found.insert(self.path.join("."), param.lazy_shape().dims::<D>().to_vec());
    }

    fn enter_module(&mut self, name: &str, _container: &str) {
        self.path.push(name.into());
    }

    fn exit_module(&mut self, _name: &str, _container: &str) {
        self.path.pop();
    }
}

/// Puts values in the place of parameters; [`fill`] has checked that each has one of its shape.
struct Filler {
    path: Vec<String>,
    tensors: Tensors,
}

impl ModuleMapper for Filler {
    fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
        let Some(stored) = self.tensors.remove(&self.path.join(".")) else {
            return param;
        };
        let data = TensorData::new(stored.values, param.lazy_shape().dims::<D>());
        let tensor = Tensor::from_data(data, &param.lazy_device());
        let id = param.id;
        param.transform_for_load(tensor, id)
    }

    fn enter_module(&mut self, name: &str, _container: &str) {
        self.path.push(name.into());
    }

    fn exit_module(&mut self, _name: &str, _container: &str) {
        self.path.pop();
    }
}
