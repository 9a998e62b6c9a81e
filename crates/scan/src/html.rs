//! Reports as single HTML files: they open without a network and carry their pictures inside.

use std::io::Cursor;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use image::imageops::{FilterType, resize};
use image::{ExtendedColorType, ImageEncoder, ImageResult, RgbImage};

/// Quality of the JPEG files inside a page: noise of frames stays visible, blocks don't.
const QUALITY: u8 = 88;

/// Quiet enough to leave the colours to the pictures; prints well.
const STYLE: &str = "
:root { color-scheme: light; --ink: #1d2126; --soft: #5d656e; --line: #dfe3e8; --paper: #ffffff; --tint: #f5f7f9; }
* { box-sizing: border-box; }
body { margin: 0 auto; max-width: 1180px; padding: 36px 28px 72px; background: var(--paper); color: var(--ink);
  font: 15px/1.5 system-ui, -apple-system, 'Segoe UI', Helvetica, Arial, sans-serif; }
h1 { font-size: 28px; line-height: 1.2; margin: 0 0 4px; }
h2 { font-size: 19px; margin: 44px 0 12px; padding-bottom: 6px; border-bottom: 1px solid var(--line); }
h3 { font-size: 15px; margin: 26px 0 8px; }
p { margin: 6px 0 12px; } .soft, figcaption, small { color: var(--soft); }
a { color: inherit; }
nav { margin: 14px 0 0; } nav a { margin-right: 16px; }
dl.facts { display: grid; grid-template-columns: repeat(auto-fill, minmax(190px, 1fr)); gap: 10px 22px; margin: 22px 0 0; }
dl.facts div { border-left: 3px solid var(--line); padding-left: 10px; min-width: 0; }
dt { color: var(--soft); font-size: 13px; } dd { margin: 0; overflow-wrap: anywhere; }
table { border-collapse: collapse; width: 100%; font-size: 14px; }
th, td { text-align: left; padding: 6px 14px 6px 0; border-bottom: 1px solid var(--line); vertical-align: top; }
th { color: var(--soft); font-weight: 600; } td.number, th.number { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
td.met { color: #1e7a45; } td.missed { color: #b3361b; }
figure { margin: 0 0 22px; } figcaption { font-size: 13px; margin-bottom: 6px; }
img { display: block; max-width: 100%; height: auto; background: var(--tint); }
.panels { display: grid; grid-template-columns: repeat(auto-fill, minmax(330px, 1fr)); gap: 14px; }
.panels svg { display: block; width: 100%; height: auto; }
.scroll { overflow-x: auto; }
details { border: 1px solid var(--line); border-radius: 6px; padding: 8px 14px; margin: 12px 0; }
summary { cursor: pointer; font-weight: 600; }
pre { overflow-x: auto; font: 12.5px/1.45 ui-monospace, Menlo, Consolas, monospace; margin: 10px 0 4px; }
code { font: 0.92em ui-monospace, Menlo, Consolas, monospace; }
@media print { body { max-width: none; padding: 0; } details:not([open]) { display: none; } }
";

/// A whole page around a body, well-formed as XML too.
pub fn page(title: &str, body: &str) -> String {
    format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\"/>\n<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\"/>\n<title>{}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n{body}\n</body>\n</html>\n",
        escape(title)
    )
}

/// Text as it may stand between tags and in attributes.
pub fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// A picture with its caption above it, at most `widest` pixels wide, inside the page.
///
/// # Errors
/// A picture of no pixels.
pub fn figure(caption: &str, picture: &RgbImage, widest: u32) -> ImageResult<String> {
    let scale = f64::from(widest) / f64::from(picture.width().max(1));
    let small = (scale < 1.0).then(|| {
        let height = (f64::from(picture.height()) * scale).round().max(1.0) as u32;
        resize(picture, widest, height, FilterType::CatmullRom)
    });
    let shown = small.as_ref().unwrap_or(picture);
    let mut bytes = Cursor::new(Vec::new());
    image::codecs::jpeg::JpegEncoder::new_with_quality(&mut bytes, QUALITY).write_image(
        shown.as_raw(),
        shown.width(),
        shown.height(),
        ExtendedColorType::Rgb8,
    )?;
    let caption = escape(caption);
    Ok(format!(
        "<figure><figcaption>{caption}</figcaption><img alt=\"{caption}\" width=\"{}\" height=\"{}\" src=\"data:image/jpeg;base64,{}\"/></figure>\n",
        shown.width(),
        shown.height(),
        STANDARD.encode(bytes.get_ref())
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_page_carries_its_pictures_and_no_text_becomes_a_tag() {
        let wide = RgbImage::from_fn(40, 10, |x, y| image::Rgb([x as u8, y as u8, 9]));
        let shown = figure("a <b> & \"c\"", &wide, 20).unwrap();
        assert!(shown.contains("width=\"20\" height=\"5\"") && shown.contains("a &lt;b&gt; &amp; &quot;c&quot;"), "{shown}");
        let data = shown.split("base64,").nth(1).unwrap().split('"').next().unwrap();
        let decoded = image::load_from_memory(&STANDARD.decode(data).unwrap()).unwrap();
        assert_eq!((decoded.width(), decoded.height()), (20, 5));
        assert!(figure("as it is", &wide, 100).unwrap().contains("width=\"40\""));
        let page = page("<script>", &shown);
        assert!(page.contains("<title>&lt;script&gt;</title>") && !page.contains("http"), "{page}");
    }
}
