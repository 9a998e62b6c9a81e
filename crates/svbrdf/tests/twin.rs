//! The SVBRDF net and its losses beside a PyTorch twin that was written from the paper (`tests/golden/generate`).

#[path = "../../../tests/golden/case.rs"]
mod case;
#[path = "../../../tests/golden/gradient.rs"]
mod gradient;

use burn::module::Module;
use burn::tensor::{Device, Tensor};
use case::{Case, TOLERANCE, golden, relative_largest, relative_norm, worst_term};
use ops::planes::values;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use render::brdf::{BrdfModel, DiffuseModel, SpecularModel};
use render::svbrdf::{CHANNELS, Svbrdf};
use render::views::{LossViews, Origin, View};
use svbrdf::loss::{LossConfig, LossKind, SvbrdfLoss};
use svbrdf::net::{Prediction, SvbrdfNetConfig};

/// Maps and all gradients of one configuration.
fn check_net(name: &str) {
    let device = Device::flex().autodiff();
    let (net, _) = svbrdf::weights::load(&golden(&format!("svbrdf/{name}")), &device).unwrap();
    let case = Case::read(&format!("svbrdf/{name}/case.safetensors"));
    let frames: Tensor<4> = case.tensor("frames", &device);
    let [count, _, h, w] = frames.dims();
    // A tensor of no frames can't be made from data.
    let (flow, valid) = match count {
        1 => (Tensor::zeros([1, 2, h, w], &device).slice([0..0, 0..2, 0..h, 0..w]), None),
        _ => (case.tensor("flow", &device), Some(case.tensor("valid", &device))),
    };
    let maps = net.forward(frames, flow, valid).stacked();

    let error = relative_largest(&values(maps.clone()), case.values("maps"));
    let gradients = gradient::errors(&net, &gradient::signed_sum(maps).backward(), &case, "gradient");
    println!("{name}: maps {error:.1e}, {} gradients, worst {:?}", gradients.len(), &gradients[..2]);
    assert!(error <= TOLERANCE, "maps differ by {error}");
    assert!(gradients[0].0 <= TOLERANCE, "{gradients:?}");
}

#[test]
fn the_papers_net_is_the_twins_with_invalid_pixels_and_an_unseen_frame() {
    check_net("paper");
}

#[test]
fn all_eight_levels_are_the_twins() {
    check_net("eight-levels");
}

#[test]
fn odd_sizes_are_the_twins() {
    check_net("odd-size");
}

#[test]
fn the_variants_are_the_twins() {
    for name in ["instance-norm", "frame-warping", "no-warp", "single-frame", "extremes"] {
        check_net(name);
    }
}

#[test]
fn the_poolings_are_the_twins() {
    for name in ["mean", "max-mean-variance", "attention"] {
        check_net(name);
    }
}

#[test]
fn the_papers_net_has_the_twins_parameters() {
    let counts: serde_json::Value = serde_json::from_slice(&std::fs::read(golden("counts.json")).unwrap()).unwrap();
    let twin = |name: &str| counts[name].as_u64().unwrap() as usize;
    let net = SvbrdfNetConfig::default().init(&Device::flex(), &mut ChaCha8Rng::seed_from_u64(0)).unwrap();
    let (all, convolutions) = (net.num_params(), net.convolution_parameters());
    assert_eq!(convolutions, twin("svbrdf_convolutions"));
    assert_eq!(format!("{:.0} M", convolutions as f64 / 1e6), "41 M");
    // The last layer's bias of 9 belongs to neither.
    assert_eq!(all - convolutions - 9, twin("svbrdf_global_track"));
}

/// A row of the fixture: xyz and 1 for a point, or 0 for a direction.
fn origin(row: &[f32]) -> Origin {
    let position = [row[0], row[1], row[2]];
    if row[3] == 1.0 { Origin::Point(position) } else { Origin::Direction(position) }
}

fn views(case: &Case) -> LossViews {
    let read = |name: &str| case.values(name).chunks_exact(8).map(|r| View::even(origin(&r[..4]), origin(&r[4..]))).collect();
    LossViews { rendering: read("views.rendering"), top: read("views.top") }
}

/// Takes from a gradient what changes the normals' length: the twin's predicted normals are normalised, and off the sphere
/// formulas differ that mean the same on it.
fn along_the_sphere(gradient: &mut [f32], maps: &[f32]) {
    let area = maps.len() / CHANNELS;
    for i in 0..area {
        let radial: f32 = (0..3).map(|c| gradient[c * area + i] * maps[c * area + i]).sum();
        (0..3).for_each(|c| gradient[c * area + i] -= radial * maps[c * area + i]);
    }
}

const MODELS: [(&str, SpecularModel, DiffuseModel); 4] = [
    ("ggx.lambert", SpecularModel::Ggx, DiffuseModel::Lambert),
    ("ggx.inria", SpecularModel::Ggx, DiffuseModel::Inria),
    ("ggx-clamped.lambert", SpecularModel::GgxClamped, DiffuseModel::Lambert),
    ("ggx-clamped.inria", SpecularModel::GgxClamped, DiffuseModel::Inria),
];

type Part = (&'static str, fn(SvbrdfLoss) -> Tensor<1>);

const PARTS: [Part; 4] = [("rendering", |l| l.rendering), ("top", |l| l.top), ("maps", |l| l.maps), ("total", |l| l.total)];

/// Both routes to the renderings' errors.
#[derive(Clone, Copy, Debug)]
enum Route {
    /// All pixels in one pass, as training on a CPU takes it.
    Fused,
    /// By tensors, as other devices take it.
    Tensors,
}

/// The losses of the fixture's maps, and the stacked maps that they can be differentiated by.
fn losses(case: &Case, model: BrdfModel, kind: LossKind, route: Route) -> (Tensor<4>, SvbrdfLoss) {
    let device = Device::flex().autodiff();
    let views = views(case);
    assert_eq!((views.rendering.len(), views.top.len()), (9, 6));
    let target = Svbrdf::from_stacked(case.tensor("target", &device));
    let stacked = case.tensor::<4>("predicted", &device).require_grad();
    let maps = Svbrdf::from_stacked(stacked.clone());
    let config = LossConfig { kind, ..LossConfig::default() };
    let loss = match route {
        Route::Fused => {
            let logits = Tensor::zeros_like(&stacked);
            config.evaluate(&Prediction { maps, logits }, &target, &views, model)
        }
        Route::Tensors => {
            let renderings = render::loss::rendering_losses(&maps, &target, &views, model);
            config.combine(&maps, &target, renderings.rendering, renderings.top)
        }
    };
    (stacked, loss)
}

/// Values of all terms, and the gradients of some of them.
fn check_losses(case: &Case, name: &str, model: BrdfModel, route: Route) {
    let v = losses(case, model, LossKind::Paper, route).1.values();
    let single_mean = losses(case, model, LossKind::SingleMean, route).1.values().total;
    let terms = [v.normal, v.diffuse, v.roughness, v.specular, v.maps, v.rendering, v.top, v.total, single_mean];
    let expected = case.values(&format!("{name}.terms"));
    let error = worst_term(&terms, expected);
    println!("{name}, {route:?}: terms {error:.1e}");
    assert!(error <= TOLERANCE, "{route:?}, {name}: {terms:?} instead of {expected:?}");

    // The map terms know no BRDF: their slopes are stored once.
    for (term, pick) in &PARTS[..if name == MODELS[0].0 { 4 } else { 2 }] {
        let (stacked, loss) = losses(case, model, LossKind::Paper, route);
        let mut slope = values(stacked.grad(&pick(loss).backward()).expect("the maps are tracked"));
        along_the_sphere(&mut slope, case.values("predicted"));
        let error = relative_norm(&slope, case.values(&format!("{name}.gradient.{term}")));
        println!("{name}, {route:?}: gradient of {term} {error:.1e}");
        assert!(error <= TOLERANCE, "{route:?}, {name}: gradient of {term} differs by {error}");
    }
}

#[test]
fn the_losses_are_the_twins_term_by_term() {
    let case = Case::read("svbrdf/losses.safetensors");
    for (name, specular, diffuse) in MODELS {
        for route in [Route::Fused, Route::Tensors] {
            check_losses(&case, name, BrdfModel { specular, diffuse }, route);
        }
    }
}
