//! From planes to pictures.

use image::RgbImage;
use ops::planes::Planes;

/// Three planes of display values as an 8-bit picture.
pub fn to_rgb(planes: &Planes) -> RgbImage {
    RgbImage::from_fn(planes.width as u32, planes.height as u32, |x, y| {
        image::Rgb(std::array::from_fn(|c| {
            let value = planes.at(c.min(planes.channels - 1), y as usize, x as usize);
            (255.0 * value.clamp(0.0, 1.0)).round() as u8
        }))
    })
}

/// Distance between two flows as grey, white from `full_px` on; 0.5 where the flow isn't valid would mislead, so black.
pub fn flow_error(found: &Planes, truth: &Planes, valid: &ops::planes::Mask, full_px: f32) -> Planes {
    let mut picture = Planes::new(3, truth.height, truth.width);
    for i in (0..truth.area()).filter(|&i| valid.data[i]) {
        let error = (found.plane(0)[i] - truth.plane(0)[i]).hypot(found.plane(1)[i] - truth.plane(1)[i]) / full_px;
        (0..3).for_each(|c| picture.plane_mut(c)[i] = error.min(1.0));
    }
    picture
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_rounded_and_clamped_and_axes_kept() {
        let mut planes = Planes::new(3, 1, 2);
        planes.set(0, 0, 1, 2.0);
        planes.set(2, 0, 0, 0.5);
        let picture = to_rgb(&planes);
        assert_eq!(picture.dimensions(), (2, 1));
        assert_eq!((picture.get_pixel(0, 0).0, picture.get_pixel(1, 0).0), ([0, 0, 128], [255, 0, 0]));
    }
}
