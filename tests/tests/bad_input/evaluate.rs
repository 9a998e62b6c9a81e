//! Bad input of `evaluate`.

use crate::case::{Place, case, check, nothing};
use crate::input::detail;
use dataset::image_io::{Overwrite, write_png8};
use render::svbrdf::SvbrdfImage;
use render::texel::Texel;
use scan::export::maps::write_truth;

fn map(place: &Place, name: &str) {
    place.empty_folder("materials/brick");
    write_png8(&place.path("materials/brick").join(name), &detail(1), Overwrite::Refuse).unwrap();
}

#[test]
fn command_lines_that_make_no_sense() {
    let cases = [
        case("no protocol", nothing, "", 2, &["Usage", "synthetic"]),
        case("an unknown protocol", nothing, "synthetik …", 2, &["synthetik", "synthetic"]),
        case("no output", nothing, "synthetic --weights WEIGHTS", 2, &["--out"]),
        case("an unknown key", nothing, "synthetic … --set textures=3", 2, &["textures", "did you mean `textured`"]),
        case("a value of another type", nothing, "synthetic … --set textured=some", 2, &["textured=some"]),
        case("too small frames", nothing, "synthetic … --set resolution=8", 2, &["resolution = 8", "64 to 4096"]),
        case("nothing to measure", nothing, "synthetic … --set textured=0 --set low_texture=0", 2, &["at least one material"]),
        case("an unknown condition", nothing, "alignment … --conditions base,rol", 2, &["no `rol`", "roll", "scans, ablation"]),
        case("no scan", nothing, "alignment … --sequences 0", 2, &["sequences = 0", "at least one scan"]),
        case("frames of no size", nothing, "alignment … --resolution 5", 2, &["resolution = 5", "64 to 4096"]),
        case(
            "a folder of other settings",
            |p| p.file("out/settings.json", r#"{ "settings": "seed = 1", "materials": "procedural", "nets": [] }"#),
            "alignment … --sequences 1 --resolution 64",
            2,
            &["out holds cases of other settings", "--force"],
        ),
        case("an unknown device", nothing, "synthetic … --device tpu", 2, &["--device tpu", "cpu"]),
    ];
    check("evaluate", &cases);
}

#[test]
fn materials_that_cannot_be_used() {
    const LINE: &str = "synthetic … --materials materials";
    let cases = [
        case("no such folder", nothing, LINE, 2, &["--materials materials", "`procedural` or a folder"]),
        case(
            "a folder without materials",
            |p| p.empty_folder("materials"),
            LINE,
            1,
            &["no material in it", "one folder per material"],
        ),
        case(
            "a material without roughness",
            |p| ["brick_Color.png", "brick_NormalGL.png"].iter().for_each(|n| map(p, n)),
            LINE,
            1,
            &["brick", "no roughness map", "looked for"],
        ),
    ];
    check("evaluate", &cases);
}

#[test]
fn weights_that_do_not_fit() {
    const LINE: &str = "synthetic --out out --weights broken";
    let cases = [
        case("no weights", nothing, LINE, 1, &["broken/manifest.json doesn't exist"]),
        case(
            "weights that are cut off",
            |p| {
                p.copy_weights();
                p.cut_in_half("broken/adjacent.safetensors");
            },
            LINE,
            1,
            &["adjacent.safetensors", "SHA-256", "copy both again"],
        ),
        case(
            "a net of another kind",
            |p| {
                p.copy_weights();
                p.edit_manifest("\"kind\": \"svbrdf\"", "\"kind\": \"classifier\"");
            },
            LINE,
            1,
            &["`svbrdf`", "is a `classifier`"],
        ),
    ];
    check("evaluate", &cases);
}

#[test]
fn outputs_that_cannot_be_written() {
    let cases = [
        case(
            "results that exist",
            |p| p.file("out/summary.json", "{}"),
            "synthetic …",
            2,
            &["holds results already", "--force"],
        ),
        case("an output below a file", |p| p.file("note", "x"), "synthetic --out note/out --weights WEIGHTS", 1, &["note/out"]),
    ];
    check("evaluate", &cases);
}

fn truth(place: &Place, folder: &str, side: usize) {
    place.empty_folder(folder);
    let texel = Texel { normal: [0.0, 0.0, 1.0], diffuse: [0.2; 3], roughness: 0.5, specular: [0.04; 3] };
    write_truth(&place.path(folder), &SvbrdfImage::constant(side, side, &texel)).unwrap();
}

#[test]
fn maps_that_cannot_be_compared() {
    const LINE: &str = "maps out --truth truth";
    let cases = [
        case("no truth", nothing, "maps out", 2, &["--truth"]),
        case("no maps", |p| truth(p, "truth", 8), LINE, 1, &["out/NormalGL.exr"]),
        case(
            "a truth without roughness",
            |p| {
                ["out", "truth"].iter().for_each(|f| truth(p, f, 8));
                std::fs::remove_file(p.path("truth/Roughness.exr")).unwrap();
            },
            LINE,
            1,
            &["truth/Roughness.exr"],
        ),
        case(
            "maps of another size",
            |p| {
                truth(p, "out", 8);
                truth(p, "truth", 16);
            },
            LINE,
            1,
            &["out (8×8)", "truth (16×16)", "--resolution"],
        ),
    ];
    check("evaluate", &cases);
}
