//! Round trips, and every way a file of weights can be wrong.

use std::{collections::BTreeMap, fs, path::Path};

use burn::{
    module::{Module, Param},
    tensor::{Device, Tensor, TensorData},
};
use serde::{Deserialize, Serialize};

use super::*;
use crate::planes::values;

#[derive(Module, Debug)]
struct Layer {
    weight: Param<Tensor<2>>,
    bias: Option<Param<Tensor<1>>>,
}

#[derive(Module, Debug)]
struct Net {
    layers: Vec<Layer>,
    scale: Param<Tensor<1>>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Architecture {
    widths: Vec<usize>,
}

impl Architecture {
    fn parameters(&self) -> usize {
        1 + self.widths.windows(2).map(|w| w[0] * w[1] + if w[1] > 1 { w[1] } else { 0 }).sum::<usize>()
    }

    fn init(&self, first: f32) -> Net {
        let device = Device::flex();
        let ramp = |n: usize| (0..n).map(|i| first + i as f32 * 0.125).collect::<Vec<_>>();
        let layers = self.widths.windows(2).map(|w| Layer {
            weight: Param::from_data(TensorData::new(ramp(w[0] * w[1]), [w[0], w[1]]), &device),
            bias: (w[1] > 1).then(|| Param::from_data(TensorData::new(ramp(w[1]), [w[1]]), &device)),
        });
        Net { layers: layers.collect(), scale: Param::from_data(TensorData::from([first]), &device) }
    }
}

const SMALL: [usize; 3] = [3, 2, 1];

fn architecture(widths: &[usize]) -> Architecture {
    Architecture { widths: widths.to_vec() }
}

fn all_values(net: &Net) -> Vec<f32> {
    let mut all = values(net.scale.val());
    for layer in &net.layers {
        all.extend(values(layer.weight.val()));
        all.extend(layer.bias.iter().flat_map(|b| values(b.val())));
    }
    all
}

fn description(widths: &[usize]) -> Description<Architecture> {
    let metrics = BTreeMap::from([("error".to_string(), 0.25)]);
    Description { kind: "ramp", architecture: architecture(widths), training: "by hand".into(), metrics }
}

fn save_small(folder: &Path) {
    save_net(folder, "one", &architecture(&SMALL).init(1.5), description(&SMALL), Precision::F32).unwrap();
}

fn load_one(folder: &Path) -> Result<(Net, NetRecord), WeightsError> {
    load_net(folder, "one", "ramp", |a: &Architecture| Ok(a.parameters()), |a| Ok(a.init(0.0)))
}

fn edit_manifest(folder: &Path, edit: impl FnOnce(&mut serde_json::Value)) {
    let path = folder.join(MANIFEST);
    let mut json = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
    edit(&mut json);
    fs::write(path, json.to_string()).unwrap();
}

#[test]
fn f32_is_exact_and_the_halves_round_to_their_precision() {
    let folder = tempfile::tempdir().unwrap();
    let net = architecture(&SMALL).init(0.1);
    let path = folder.path().join("net.safetensors");
    save(&net, &path, Precision::F32).unwrap();
    let loaded = load(architecture(&SMALL).init(9.0), &path).unwrap();
    assert_eq!(all_values(&loaded), all_values(&net));

    for (precision, bits) in [(Precision::F16, 11), (Precision::Bf16, 8)] {
        save(&net, &path, precision).unwrap();
        let halves = all_values(&load(architecture(&SMALL).init(9.0), &path).unwrap());
        assert_ne!(halves, all_values(&net));
        for (half, exact) in halves.iter().zip(all_values(&net)) {
            assert!((half - exact).abs() <= exact.abs() * 0.5f32.powi(bits), "{precision}: {half} for {exact}");
        }
    }
    // The range of single precision.
    save(&architecture(&SMALL).init(1e30), &path, Precision::Bf16).unwrap();
    let large = all_values(&load(architecture(&SMALL).init(0.0), &path).unwrap());
    assert!(large.iter().all(|v| (v / 1e30 - 1.0).abs() < 0.004), "{large:?}");
}

/// A folder with one net in three files.
fn save_in_three(folder: &Path) -> Net {
    save_small(folder);
    let net = architecture(&SMALL).init(1.5);
    fs::remove_file(file_of(folder, "one")).unwrap();
    let record = Manifest::read(folder).unwrap().nets["one"].clone();
    add_net(folder, "one", &tensors_of(&net), record, 28).unwrap();
    net
}

#[test]
fn a_net_in_several_files_is_the_net() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let net = save_in_three(folder);
    let names: Vec<_> = Manifest::read(folder).unwrap().nets["one"].shards.iter().map(|s| s.file.clone()).collect();
    // By name: a bias of 8 bytes, a weight of 24, then 8 and 4.
    assert_eq!(names, ["one-00001-of-00003.safetensors", "one-00002-of-00003.safetensors", "one-00003-of-00003.safetensors"]);
    assert_eq!(all_values(&load_one(folder).unwrap().0), all_values(&net));
    // What fits lies in one file, of the usual name.
    let record = Manifest::read(folder).unwrap().nets["one"].clone();
    add_net(folder, "two", &tensors_of(&net), record, 44).unwrap();
    let record = &Manifest::read(folder).unwrap().nets["two"];
    assert!(record.shards.is_empty() && record.sha256.is_some() && file_of(folder, "two").is_file());
}

#[test]
fn files_of_a_net_that_do_not_belong_together_are_named_errors() {
    let check = |spoil: &dyn Fn(&Path), right: &dyn Fn(&WeightsError) -> bool| {
        let folder = tempfile::tempdir().unwrap();
        save_in_three(folder.path());
        spoil(folder.path());
        let error = load_one(folder.path()).unwrap_err();
        assert!(right(&error), "{error}");
    };
    let part = |n: usize| format!("one-0000{n}-of-00003.safetensors");
    check(&|f| fs::remove_file(f.join(part(2))).unwrap(), &|e| matches!(e, WeightsError::Missing { .. }));
    check(&|f| fs::rename(f.join(part(2)), f.join(part(1))).unwrap(), &|e| matches!(e, WeightsError::Checksum { .. }));
    let edit = |f: &Path, edit: &dyn Fn(&mut serde_json::Value)| edit_manifest(f, |j| edit(&mut j["nets"]["one"]["shards"]));
    check(&|f| edit(f, &|s| s[2] = s[0].clone()), &|e| matches!(e, WeightsError::Twice { .. }));
    check(&|f| edit(f, &|s| s.as_array_mut().unwrap().truncate(2)), &|e| matches!(e, WeightsError::MissingTensor { .. }));
    for elsewhere in ["../one.safetensors", "/one.safetensors", "", ".."] {
        check(&|f| edit(f, &|s| s[0]["file"] = elsewhere.into()), &|e| matches!(e, WeightsError::BadManifest { .. }));
    }
}

#[test]
fn tensors_are_named_by_their_path_and_the_file_is_the_same_every_time() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("net.safetensors");
    let first = save(&architecture(&SMALL).init(1.0), &path, Precision::F16).unwrap();
    let bytes = fs::read(&path).unwrap();
    let file = safetensors::SafeTensors::deserialize(&bytes).unwrap();
    let mut names = file.names();
    names.sort_unstable();
    assert_eq!(names, ["layers.0.bias", "layers.0.weight", "layers.1.weight", "scale"]);
    assert_eq!(save(&architecture(&SMALL).init(1.0), &path, Precision::F16).unwrap(), first);
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1, "no scratch file is left");
}

#[test]
fn parameters_keep_identity_and_gradients_after_loading() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("net.safetensors");
    let net = architecture(&SMALL).init(1.0);
    save(&net, &path, Precision::F32).unwrap();
    let training = net.train();
    let id = training.layers[0].weight.id;
    let loaded = load(training, &path).unwrap();
    assert_eq!(loaded.layers[0].weight.id, id);
    assert!(loaded.layers[0].weight.val().is_require_grad());
}

#[test]
fn a_folder_holds_several_nets_with_their_records() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    save_small(folder);
    save_net(folder, "two", &architecture(&[4, 4]).init(2.0), description(&[4, 4]), Precision::F16).unwrap();
    let (net, record) = load_one(folder).unwrap();
    assert_eq!(all_values(&net), all_values(&architecture(&SMALL).init(1.5)));
    assert_eq!((record.parameters, record.metrics["error"]), (11, 0.25));
    let mut failed = description(&[4, 4]);
    failed.metrics.extend([("nothing".into(), f64::NAN), ("unbounded".into(), f64::INFINITY)]);
    save_net(folder, "failed", &architecture(&[4, 4]).init(2.0), failed, Precision::F32).unwrap();
    assert_eq!(Manifest::read(folder).unwrap().nets["failed"].metrics.len(), 1);
    let (net, record) = load_net(folder, "two", "ramp", |a: &Architecture| Ok(a.parameters()), |a| Ok(a.init(0.0))).unwrap();
    assert_eq!((values(net.scale.val()), record.precision), (vec![2.0], Precision::F16));
}

#[test]
fn broken_files_are_named_errors() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("net.safetensors");
    let fresh = || architecture(&SMALL).init(0.0);
    assert!(matches!(load(fresh(), &path), Err(WeightsError::Missing { .. })));
    save(&fresh(), &path, Precision::F32).unwrap();
    let whole = fs::read(&path).unwrap();
    for length in [0, 4, 8, 40, whole.len() - 1] {
        fs::write(&path, &whole[..length]).unwrap();
        let error = load(fresh(), &path).unwrap_err();
        assert!(matches!(error, WeightsError::NotSafetensors { .. }), "{length}: {error}");
    }
    fs::write(&path, b"\x89PNG\r\n\x1a\n and so on, no weights at all").unwrap();
    assert!(matches!(load(fresh(), &path), Err(WeightsError::NotSafetensors { .. })));
}

#[test]
fn another_architecture_is_named_by_tensor_and_shape() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("net.safetensors");
    save(&architecture(&SMALL).init(1.0), &path, Precision::F32).unwrap();
    let load_as = |widths: &[usize]| load(architecture(widths).init(0.0), &path).unwrap_err();

    let WeightsError::Shape { tensor, expected, found, .. } = load_as(&[5, 2, 1]) else { panic!("a shape differs") };
    assert_eq!((tensor.as_str(), expected, found), ("layers.0.weight", vec![5, 2], vec![3, 2]));
    let WeightsError::MissingTensor { tensor, .. } = load_as(&[3, 2, 1, 1]) else { panic!("a tensor is missing") };
    assert_eq!(tensor, "layers.2.weight");
    let WeightsError::UnexpectedTensor { tensor, .. } = load_as(&[3, 2]) else { panic!("a tensor too many") };
    assert_eq!(tensor, "layers.1.weight");
}

#[test]
fn values_that_are_not_finite_are_refused_both_ways() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("net.safetensors");
    let refused = |value: f32, precision| {
        let error = save(&architecture(&SMALL).init(value), &path, precision).unwrap_err();
        assert!(matches!(error, WeightsError::NotFinite { .. }), "{error}");
    };
    refused(f32::NAN, Precision::F32);
    refused(1e5, Precision::F16);
    save(&architecture(&SMALL).init(1.0), &path, Precision::F32).unwrap();
    let mut bytes = fs::read(&path).unwrap();
    let end = bytes.len();
    bytes[end - 4..].copy_from_slice(&f32::INFINITY.to_le_bytes());
    fs::write(&path, bytes).unwrap();
    let error = load(architecture(&SMALL).init(0.0), &path).unwrap_err();
    assert!(matches!(error, WeightsError::NotFinite { .. }), "{error}");
}

#[test]
fn a_manifest_that_does_not_fit_is_a_named_error() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    assert!(matches!(load_one(folder), Err(WeightsError::Missing { .. })));
    let check = |edit: &dyn Fn(&mut serde_json::Value), right: &dyn Fn(&WeightsError) -> bool| {
        let _ = fs::remove_file(folder.join(MANIFEST));
        save_small(folder);
        edit_manifest(folder, edit);
        let error = load_one(folder).unwrap_err();
        assert!(right(&error), "{error}");
    };
    check(&|j| j["format"] = 7.into(), &|e| matches!(e, WeightsError::Format { found: 7, .. }));
    check(&|j| j["sort"] = 7.into(), &|e| matches!(e, WeightsError::BadManifest { .. }));
    check(&|j| *j = 7.into(), &|e| matches!(e, WeightsError::BadManifest { .. }));
    check(&|j| j["nets"] = serde_json::json!({}), &|e| matches!(e, WeightsError::NoNet { .. }));
    check(&|j| j["nets"]["one"]["kind"] = "pwc".into(), &|e| matches!(e, WeightsError::Kind { .. }));
    let heights = serde_json::json!({ "heights": [3] });
    check(&|j| j["nets"]["one"]["architecture"] = heights.clone(), &|e| matches!(e, WeightsError::Architecture { .. }));
    check(&|j| j["nets"]["one"]["sha256"] = "00".into(), &|e| matches!(e, WeightsError::Checksum { .. }));
    let wide = serde_json::json!({ "widths": [4, 2, 1] });
    check(&|j| j["nets"]["one"]["architecture"] = wide.clone(), &|e| matches!(e, WeightsError::Shape { .. }));
    let huge = serde_json::json!({ "widths": [1 << 20, 1 << 20] });
    check(&|j| j["nets"]["one"]["architecture"] = huge.clone(), &|e| matches!(e, WeightsError::TooFew { .. }));
}

#[test]
fn an_unreadable_manifest_is_not_overwritten() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join(MANIFEST), "{").unwrap();
    let net = architecture(&SMALL).init(1.0);
    let error = save_net(folder.path(), "one", &net, description(&SMALL), Precision::F32).unwrap_err();
    assert!(matches!(error, WeightsError::BadManifest { .. }), "{error}");
    assert_eq!(fs::read(folder.path().join(MANIFEST)).unwrap(), b"{");
}
