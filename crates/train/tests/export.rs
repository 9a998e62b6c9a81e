//! Exports hold what PyTorch loads: names, shapes and numbers are the `state_dict` of the nets in `python/`, whose outputs the
//! goldens recorded. So this needs no Python; where there is PyTorch, `.ci/run` lets `load.py` of an export compare outputs, and
//! `tests/golden/generate/check.py` those of every golden net.

#[path = "../../../tests/golden/case.rs"]
mod case;

use std::fs;
use std::path::{Path, PathBuf};

use burn::tensor::{Device, Tensor};
use case::{Case, TOLERANCE, golden, relative_largest};
use ops::planes::values;
use ops::weights::{MANIFEST, Precision, Tensors, read_tensors};
use serde_json::{Value, json};
use train::export::{Exported, Request, export};

/// Golden nets as those of a run: folder, name there, name in the run.
const NETS: [(&str, &str, &str); 4] = [
    ("flow/learning-aids", "adjacent", "adjacent"),
    ("flow/paper-eighth", "adjacent", "distant"),
    ("flow/published-sixteenth", "adjacent", "chairs"),
    ("svbrdf/extremes", "svbrdf", "svbrdf"),
];

/// A run folder as a finished run leaves it, with the goldens for nets.
fn run(home: &Path) -> PathBuf {
    let run = home.join("run");
    let weights = run.join("weights");
    fs::create_dir_all(&weights).unwrap();
    let mut nets = serde_json::Map::new();
    for (folder, from, to) in NETS {
        let record: Value = serde_json::from_slice(&fs::read(golden(folder).join(MANIFEST)).unwrap()).unwrap();
        nets.insert(to.into(), record["nets"][from].clone());
        fs::copy(golden(folder).join(format!("{from}.safetensors")), weights.join(format!("{to}.safetensors"))).unwrap();
    }
    fs::write(weights.join(MANIFEST), json!({ "format": 1, "nets": nets }).to_string()).unwrap();
    let steps = NETS.map(|(_, _, name)| format!("[{name}]\nsteps = 1\n")).concat();
    fs::write(run.join("config.toml"), format!("{steps}[flow]\ninit = \"none\"\n")).unwrap();
    fs::write(run.join("run.json"), json!({ "name": "golden", "seed": 1, "revision": null }).to_string()).unwrap();
    let materials = json!([
        { "name": "a", "split": "train", "identity": "a", "source": "procedural bricks", "licence": "CC0-1.0 (generated)" },
        { "name": "Wood", "split": "train", "identity": "b", "source": "pbr /home/me/Wood", "licence": "CC-BY-4.0" },
    ]);
    fs::write(run.join("materials.json"), materials.to_string()).unwrap();
    fs::write(run.join("report.json"), json!({ "minutes": 3.0, "maps_l1_ratio": 0.5, "stages": [] }).to_string()).unwrap();
    run
}

fn request(home: &Path, precision: Precision, largest_file: u64) -> Request {
    Request { run: run(home), out: home.join("out"), precision, largest_file, force: true }
}

fn manifest(home: &Path) -> Value {
    serde_json::from_slice(&fs::read(home.join("out").join(MANIFEST)).unwrap()).unwrap()
}

/// The tensors of a net, from as many files as its record names.
fn tensors(home: &Path, name: &str) -> Tensors {
    let record = &manifest(home)["nets"][name];
    let files = match record["shards"].as_array() {
        Some(shards) => shards.iter().map(|s| s["file"].as_str().unwrap().to_string()).collect(),
        None => vec![format!("{name}.safetensors")],
    };
    files.iter().flat_map(|file| read_tensors(&home.join("out").join(file)).unwrap()).collect()
}

#[test]
fn an_export_is_the_state_dict_and_its_outputs_are_pytorchs() {
    let home = tempfile::tempdir().unwrap();
    let home = home.path();
    // Small enough for several files of the larger nets.
    export(&request(home, Precision::F32, 100_000)).unwrap();
    for (folder, from, to) in NETS {
        let twin = read_tensors(&golden(folder).join(format!("{from}.safetensors"))).unwrap();
        assert_eq!(tensors(home, to), twin, "{to}");
    }
    let nets = &manifest(home)["nets"];
    assert!(nets["adjacent"]["shards"].is_null() && nets["adjacent"]["sha256"].is_string());
    assert!(nets["distant"]["shards"].as_array().unwrap().len() > 3);

    let (device, out) = (Device::flex(), home.join("out"));
    for (folder, _, to) in &NETS[..3] {
        let case = Case::read(&format!("{folder}/case.safetensors"));
        let images: Tensor<4> = case.tensor("images", &device);
        let [n, c, h, w] = images.dims();
        let half = |from: usize| images.clone().slice([from..from + n / 2, 0..c, 0..h, 0..w]);
        let net = flow::weights::load(&out, to, &device).unwrap().0;
        let error = relative_largest(&values(net.flow(half(0), half(n / 2))), case.values("flow"));
        assert!(error <= TOLERANCE, "{to} differs by {error}");
    }
    let case = Case::read("svbrdf/extremes/case.safetensors");
    let net = svbrdf::weights::load(&out, &device).unwrap().0;
    let maps = net.forward(case.tensor("frames", &device), case.tensor("flow", &device), Some(case.tensor("valid", &device)));
    let error = relative_largest(&values(maps.stacked()), case.values("maps"));
    assert!(error <= TOLERANCE, "svbrdf differs by {error}");
}

#[test]
fn an_export_says_what_it_is() {
    let home = tempfile::tempdir().unwrap();
    let home = home.path();
    let exported = export(&request(home, Precision::F16, u64::MAX)).unwrap();
    let manifest = manifest(home);
    assert_eq!(manifest["evaluation"], json!({ "maps_l1_ratio": 0.5 }));
    for Exported { net, record, .. } in &exported {
        let written = &manifest["nets"][net];
        assert_eq!(written["precision"], "f16");
        assert!(written["architecture"].is_object() && written["sha256"].is_string(), "{written}");
        let names = |ports: &[ops::weights::Port]| ports.iter().map(|p| p.name.clone()).collect::<Vec<_>>().join(" ");
        let expected = if record.kind == "pwc" { ("first second", "flow") } else { ("frames flow valid", "maps") };
        assert_eq!((names(&record.inputs).as_str(), names(&record.outputs).as_str()), expected);
        let data: Vec<_> = record.data.iter().map(|d| (d.licence.as_str(), d.names.join(" "))).collect();
        assert_eq!(data, [("CC-BY-4.0", "Wood".into()), ("CC0-1.0 (generated)", String::new())]);
    }
    let files = ["README.md", "load.py", "pwc.py", "svbrdf.py", "examples.safetensors"];
    assert!(files.iter().all(|file| home.join("out").join(file).is_file()));
    let card = fs::read_to_string(home.join("out/README.md")).unwrap();
    for part in ["CC-BY-4.0", "Wood", "gamma-encoded", "from load import load", "f16", "`maps_l1_ratio` | 0.5"] {
        assert!(card.contains(part), "no `{part}` in\n{card}");
    }
    assert!(!card.contains("/home"), "{card}");
    // In order, as `load.py` hands them on.
    let examples = read_tensors(&home.join("out/examples.safetensors")).unwrap();
    let names: Vec<_> = examples.keys().filter(|name| name.starts_with("svbrdf")).collect();
    assert_eq!(names, ["svbrdf.input.0.frames", "svbrdf.input.1.flow", "svbrdf.input.2.valid", "svbrdf.output"]);
    assert_eq!(examples["svbrdf.output"].shape, [1, 10, 128, 128]);
    assert!(fs::read_to_string(home.join("out/load.py")).unwrap().lines().count() <= 40);
}

#[test]
fn fewer_bits_lose_a_little_and_the_loss_is_told() {
    let loss = |precision| {
        let home = tempfile::tempdir().unwrap();
        let exported = export(&request(home.path(), precision, u64::MAX)).unwrap();
        exported.into_iter().map(|e| (e.net.clone(), (e.rounding, e.rounding.words(&e.record)))).collect::<Vec<_>>()
    };
    for (_, (rounding, words)) in loss(Precision::F32) {
        assert_eq!((rounding.weight_largest, rounding.output_largest, words.as_str()), (0.0, 0.0, "stored exactly"));
    }
    // The goldens of flow are rounded to half precision already; bfloat16 has three bits less.
    for (net, (rounding, words)) in loss(Precision::Bf16) {
        assert!(rounding.weight_largest > 0.0 && rounding.weight_mean < 0.01, "{net}: {rounding:?}");
        assert!(rounding.output_mean > 0.0 && rounding.output_mean <= rounding.output_largest, "{net}: {rounding:?}");
        assert!(words.contains("on average") && words.contains("128 × 128 px"), "{words}");
    }
}
