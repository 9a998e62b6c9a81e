//! Binary PPM (`P6`, 8 bit), the image format of the published FlyingChairs set.

use ops::planes::Planes;

const MAX_SIDE: usize = 1 << 15;

/// Parses the bytes of a binary PPM into 3 planes in \[0, 1\], as encoded in the file.
///
/// # Errors
/// A sentence that says what was found instead.
pub fn parse(bytes: &[u8]) -> Result<Planes, String> {
    if !bytes.starts_with(b"P6") {
        return Err(format!("the file begins with {:?}", String::from_utf8_lossy(&bytes[..bytes.len().min(2)])));
    }
    let mut at = 2;
    let mut numbers = [0usize; 3];
    for (number, name) in numbers.iter_mut().zip(["width", "height", "largest value"]) {
        *number = header_number(bytes, &mut at).ok_or_else(|| format!("the header holds no {name}"))?;
    }
    let [width, height, largest] = numbers;
    if !(1..=MAX_SIDE).contains(&width) || !(1..=MAX_SIDE).contains(&height) {
        return Err(format!("the header says {width}×{height} pixels"));
    }
    if !(1..=255).contains(&largest) {
        return Err(format!("the largest value is {largest}, only 8-bit files (1 to 255) are supported"));
    }
    // One white-space byte ends the header.
    let body = bytes.get(at + 1..).unwrap_or(&[]);
    if body.len() < width * height * 3 {
        return Err(format!("{width}×{height} pixels take {} bytes, but {} follow", width * height * 3, body.len()));
    }
    let mut image = Planes::new(3, height, width);
    for (i, pixel) in body.chunks_exact(3).take(width * height).enumerate() {
        for (c, &value) in pixel.iter().enumerate() {
            image.data[c * width * height + i] = (f32::from(value) / largest as f32).min(1.0);
        }
    }
    Ok(image)
}

/// The next decimal number, behind white space and comments.
fn header_number(bytes: &[u8], at: &mut usize) -> Option<usize> {
    loop {
        match bytes.get(*at)? {
            b'#' => *at += bytes[*at..].iter().position(|&b| b == b'\n')?,
            b if b.is_ascii_whitespace() => *at += 1,
            b if b.is_ascii_digit() => break,
            _ => return None,
        }
    }
    let digits = bytes[*at..].iter().take_while(|b| b.is_ascii_digit()).take(9).count();
    let text = std::str::from_utf8(&bytes[*at..*at + digits]).ok()?;
    *at += digits;
    text.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::damage::Damage;
    use proptest::prelude::*;

    #[test]
    fn pixels_and_comments_are_read() {
        let mut bytes = b"P6\n# made by hand\n2 1\n255\n".to_vec();
        bytes.extend_from_slice(&[255, 0, 51, 0, 102, 255]);
        let image = parse(&bytes).unwrap();
        assert_eq!((image.channels, image.height, image.width), (3, 1, 2));
        assert_eq!(image.data, vec![1.0, 0.0, 0.0, 0.4, 0.2, 1.0]);
    }

    #[test]
    fn malformed_files_are_named() {
        let refused = |bytes: &[u8]| parse(bytes).unwrap_err();
        assert!(refused(b"P5\n1 1 255\n0").contains("P5"));
        assert!(refused(b"P6\n1 x").contains("no height"));
        assert!(refused(b"P6 4 4 255\n123").contains("48 bytes, but 3 follow"));
        assert!(refused(b"P6 1 1 65535\n123456").contains("65535"));
        assert!(refused(b"P6 0 1 255\n").contains("0×1"));
        assert!(refused(b"P6 # no end").contains("no width"));
    }

    proptest! {
        #[test]
        fn any_bytes_are_read_or_refused(tail in proptest::collection::vec(any::<u8>(), 0..48)) {
            let mut bytes = b"P6 ".to_vec();
            bytes.extend(tail);
            let _ = parse(&bytes).map(|image| assert_eq!(image.channels, 3));
        }

        #[test]
        fn damaged_files_are_read_or_refused(damage in Damage::any()) {
            let good = [b"P6\n# made by hand\n5 4\n255\n" as &[u8], &[200; 60]].concat();
            if let Ok(image) = parse(&damage.done_to(&good)) {
                prop_assert!(image.data.iter().all(|v| (0.0..=1.0).contains(v)));
            }
        }
    }
}
