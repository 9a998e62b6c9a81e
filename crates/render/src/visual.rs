//! Pictures of maps for previews and contact sheets.

use ops::colour::gamma_encode;
use ops::planes::Planes;

use crate::svbrdf::SvbrdfImage;

/// Normal as colours: (n + 1)/2.
pub fn normal_picture(maps: &SvbrdfImage) -> Planes {
    maps.normal.clone().map(|v| (0.5 * v + 0.5).clamp(0.0, 1.0))
}

/// A linear albedo as seen on a screen.
pub fn albedo_picture(albedo: &Planes) -> Planes {
    albedo.clone().map(|v| gamma_encode(v.clamp(0.0, 1.0)))
}

/// Roughness as grey.
pub fn roughness_picture(maps: &SvbrdfImage) -> Planes {
    let grey = maps.roughness.clone().map(|v| v.clamp(0.0, 1.0));
    Planes::stack(&[&grey, &grey, &grey])
}

/// The maps side by side, normal | diffuse | roughness | specular, as RGB; albedos are gamma-encoded.
///
/// # Shapes
/// 3 channels, `height`, 4·`width`
pub fn row_picture(maps: &SvbrdfImage) -> Planes {
    beside(&[&normal_picture(maps), &albedo_picture(&maps.diffuse), &roughness_picture(maps), &albedo_picture(&maps.specular)])
}

/// Pictures of one height side by side.
///
/// # Panics
/// If there is no picture, or heights or channels differ.
pub fn beside(pictures: &[&Planes]) -> Planes {
    let (channels, height) = (pictures[0].channels, pictures[0].height);
    assert!(pictures.iter().all(|p| (p.channels, p.height) == (channels, height)), "pictures side by side differ in height");
    let mut data = Vec::with_capacity(pictures.iter().map(|p| p.data.len()).sum());
    for c in 0..channels {
        for y in 0..height {
            pictures.iter().for_each(|p| data.extend_from_slice(&p.plane(c)[y * p.width..][..p.width]));
        }
    }
    Planes::from_vec(channels, height, pictures.iter().map(|p| p.width).sum(), data)
}

/// Pictures of one width below each other.
///
/// # Panics
/// If there is no picture, or widths or channels differ.
pub fn below(pictures: &[&Planes]) -> Planes {
    let (channels, width) = (pictures[0].channels, pictures[0].width);
    assert!(pictures.iter().all(|p| (p.channels, p.width) == (channels, width)), "pictures below each other differ in width");
    let mut data = Vec::with_capacity(pictures.iter().map(|p| p.data.len()).sum());
    (0..channels).for_each(|c| pictures.iter().for_each(|p| data.extend_from_slice(p.plane(c))));
    Planes::from_vec(channels, pictures.iter().map(|p| p.height).sum(), width, data)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::texel::Texel;

    #[test]
    fn maps_stand_side_by_side() {
        let texel = Texel { normal: [0.0, 0.0, 1.0], diffuse: [1.0, 0.0, 0.2], roughness: 0.3, specular: [0.0, 1.0, 0.5] };
        let row = row_picture(&SvbrdfImage::constant(2, 3, &texel));
        assert_eq!((row.channels, row.height, row.width), (3, 2, 12));
        let pixel = |x: usize| [row.at(0, 1, x), row.at(1, 1, x), row.at(2, 1, x)];
        assert_eq!(pixel(0), [0.5, 0.5, 1.0]);
        assert_eq!(pixel(3), [1.0, 0.0, gamma_encode(0.2)]);
        assert_eq!(pixel(6), [0.3; 3]);
        assert_eq!(pixel(11), [0.0, 1.0, gamma_encode(0.5)]);
        let both = below(&[&row, &row]);
        assert_eq!((both.height, both.at(2, 3, 4)), (4, row.at(2, 1, 4)));
    }
}
