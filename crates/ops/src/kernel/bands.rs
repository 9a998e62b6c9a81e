//! Planes split into bands of rows, so that tasks may fill them at the same time.

/// Planes of `width` columns and `height` rows in groups of `group`, split into bands of `rows` rows: piece
/// `group index · bands + band` has the band's part of each plane of the group.
pub(super) fn bands<T>(planes: &mut [T], [height, width]: [usize; 2], group: usize, rows: usize) -> Vec<Vec<&mut [T]>> {
    let (area, count) = (height * width, height.div_ceil(rows));
    let mut pieces = Vec::with_capacity((planes.len() / area).div_ceil(group) * count);
    for planes in planes.chunks_mut(group * area) {
        let first = pieces.len();
        pieces.resize_with(first + count, || Vec::with_capacity(group));
        for plane in planes.chunks_mut(area) {
            plane.chunks_mut(rows * width).zip(&mut pieces[first..]).for_each(|(part, piece)| piece.push(part));
        }
    }
    pieces
}
