//! `report.html` of a real run: one file that is well-formed, leads nowhere, and shows every curve and picture, in a browser too
//! where there is one.

use std::path::Path;
use std::process::Command;

use acceptance::programs;

const CONFIG: &str = r#"
[[materials]]
type = "procedural"
size = 64
count = 34
[flow]
init = "none"
architecture = { channels = [4, 8], convs_per_level = 1, estimator = [8], radius = 2, context = [] }
[adjacent]
steps = 6
batch = 1
pairs = { resolution = 48, crop = 32 }
mixed_videos = 2
validation_pairs = 1
optimisation = { validate_every = 2 }
[svbrdf]
steps = 6
net = { width = 4, levels = 3 }
exemplars = { resolution = 32, key_frames = [1, 2], mixed_videos = 2 }
median_exemplars = 2
validation_exemplars = 1
optimisation = { learning_rate = 1e-3, warm_up = 4, validate_every = 2 }
[report.synthetic]
textured = 1
low_texture = 1
featureless = 0
resolution = 64
map_resolution = 32
pairs = 1
constant_videos = 2
"#;
/// Names under which browsers of this kind are installed.
const BROWSERS: [&str; 4] = ["chromium", "chromium-browser", "google-chrome", "google-chrome-stable"];
/// Curves of the two stages, and those that must be among them.
const CURVES: [&str; 8] = ["loss", "matching", "level_0", "epe_ratio", "rendering", "top", "gradient_norm", "maps_l1_ratio"];
/// Asks the browser what it shows and leaves the answer in the page.
const QUESTIONS: &str = r#"<script>
addEventListener("load", () => {
  const images = [...document.images], curves = [...document.querySelectorAll("svg")];
  const seen = (element) => element.getBoundingClientRect().width > 100;
  document.body.dataset.answer = [
    images.length, images.filter((image) => image.complete && image.naturalWidth > 0).length,
    curves.length, curves.filter(seen).length,
    document.documentElement.scrollWidth <= innerWidth, performance.getEntriesByType("resource").filter((r) => !r.name.startsWith("data:")).length,
  ].join(" ");
});
</script></body>"#;

/// Tags that don't close, attributes without quotes and stray brackets: anything that no XML reader would take.
fn check_well_formed(page: &str) {
    let mut open: Vec<&str> = Vec::new();
    let mut rest = page.strip_prefix("<!DOCTYPE html>").expect("a document type");
    while let Some((text, tagged)) = rest.split_once('<') {
        assert!(!text.contains('>') || open.last() == Some(&"style"), "a bracket in the text: {text}");
        let (tag, after) = tagged.split_once('>').expect("a tag that ends");
        rest = after;
        if let Some(name) = tag.strip_prefix('/') {
            assert_eq!(open.pop(), Some(name));
            continue;
        }
        assert_eq!(tag.matches('"').count() % 2, 0, "<{tag}>");
        if !tag.ends_with('/') {
            open.push(tag.split_whitespace().next().expect("a name"));
        }
    }
    assert!(open.is_empty(), "{open:?} stay open");
}

/// What a browser says to [`QUESTIONS`].
fn answer(browser: &str, folder: &Path, page: &str) -> String {
    let path = folder.join("asked.html");
    std::fs::write(&path, page.replace("</body>", QUESTIONS)).unwrap();
    let mut command = Command::new(browser);
    command.args(["--headless", "--no-sandbox", "--disable-gpu", "--window-size=1280,1000", "--dump-dom"]);
    command.arg(format!("--user-data-dir={}", folder.join("browser").display())).arg(format!("file://{}", path.display()));
    let shown = programs::ended(&mut command);
    let answer = shown.stdout.split("data-answer=\"").nth(1).and_then(|rest| rest.split('"').next());
    answer.unwrap_or_else(|| panic!("{browser} shows no page: {}", shown.stderr)).to_string()
}

#[test]
fn a_run_ends_in_a_page_of_one_file() {
    let home = tempfile::tempdir().unwrap();
    std::fs::write(home.path().join("tiny.toml"), CONFIG).unwrap();
    let ended = programs::run("train", home.path(), &["--config", "tiny.toml", "--out", "run"]);
    assert_eq!(ended.code, Some(0), "{}", ended.stderr);
    let page = std::fs::read_to_string(home.path().join("run/report.html")).unwrap();
    check_well_formed(&page);
    assert!(!page.replace("xmlns=\"http://www.w3.org/2000/svg\"", "").contains("://"), "the page leads out");
    for curve in CURVES {
        assert!(page.contains(&format!(">{curve}</text>")), "no curve of {curve}");
    }
    for part in ["maps_l1_ratio", "≤ 0.85", "every_steps = 100", "waited for data", "evaluation, "] {
        assert!(page.contains(part), "`{part}` isn't on the page");
    }
    let (images, curves) = (page.matches("<img ").count(), page.matches("<svg ").count());
    let sheets = std::fs::read_dir(home.path().join("run/report")).unwrap().flatten();
    let sheets = sheets.filter(|entry| entry.file_name().to_string_lossy().starts_with("sheet-")).count();
    // First and last picture of a pair and of maps, and frames.
    assert_eq!((images, sheets > 0), (2 + 2 + 1 + sheets, true));
    match BROWSERS.into_iter().find(|browser| programs::available(browser)) {
        Some(browser) => {
            let expected = format!("{images} {images} {curves} {curves} true 0");
            assert_eq!(
                answer(browser, home.path(), &page),
                expected,
                "images, shown, curves, shown, fits, loaded from outside"
            );
        }
        None => eprintln!("not looked at in a browser: none of {} is installed", BROWSERS.join(", ")),
    }
    // A resumed run that is done already makes its report anew.
    std::fs::remove_file(home.path().join("run/report.html")).unwrap();
    let again = programs::run("train", home.path(), &["--resume", "run"]);
    assert_eq!(again.code, Some(0), "{}", again.stderr);
    assert!(home.path().join("run/report.html").is_file());
}
