//! Letters on pictures: Noto Sans Mono, rasterised by `noto-sans-mono-bitmap`; no system font.

use noto_sans_mono_bitmap::{FontWeight, RasterHeight, get_raster, get_raster_width};

use super::Picture;

const HEIGHT: RasterHeight = RasterHeight::Size20;
/// Distance from the picture's edge, and around a caption's text [pixels].
const MARGIN: usize = 14;
const PADDING: usize = 6;
/// Opacity of the dark plate under a caption.
const PLATE_ALPHA: u8 = 120;

/// Where a caption stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CaptionPlace {
    /// Lower left corner.
    BottomLeft,
    /// Middle of the left edge.
    Left,
    /// Middle of the right edge.
    Right,
    /// Middle of the upper edge.
    Top,
    /// Middle of the lower edge.
    Bottom,
}

/// Lines of text over a picture.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Caption {
    /// Lines, separated by `\n`. Characters outside printable ASCII are drawn as `?`.
    pub text: String,
    /// Where.
    pub place: CaptionPlace,
}

/// Width and height of `text` [pixels].
fn text_size(text: &str) -> [usize; 2] {
    let columns = text.lines().map(|line| line.chars().count()).max().unwrap_or(0);
    [columns * get_raster_width(FontWeight::Regular, HEIGHT), text.lines().count() * HEIGHT.val()]
}

/// Draws `caption` on a dark plate.
pub(super) fn draw_caption(picture: &mut Picture, caption: &Caption) {
    let text = text_size(&caption.text);
    let plate = text.map(|edge| edge + 2 * PADDING);
    let free = [0, 1].map(|axis| picture.size[axis].saturating_sub(plate[axis]));
    let (near, far) = (free.map(|f| MARGIN.min(f)), free.map(|f| f.saturating_sub(MARGIN)));
    let [x, y] = match caption.place {
        CaptionPlace::BottomLeft => [near[0], far[1]],
        CaptionPlace::Left => [near[0], free[1] / 2],
        CaptionPlace::Right => [far[0], free[1] / 2],
        CaptionPlace::Top => [free[0] / 2, near[1]],
        CaptionPlace::Bottom => [free[0] / 2, far[1]],
    };
    for row in y..y + plate[1] {
        for column in x..x + plate[0] {
            picture.blend([column, row], [8, 10, 14], PLATE_ALPHA);
        }
    }
    draw_text(picture, &caption.text, [x + PADDING, y + PADDING], [240, 242, 245]);
}

/// Draws `text` with its upper left corner at `corner` [pixels].
pub(super) fn draw_text(picture: &mut Picture, text: &str, corner: [usize; 2], colour: [u8; 3]) {
    for (line_index, line) in text.lines().enumerate() {
        let mut x = corner[0];
        let y = corner[1] + line_index * HEIGHT.val();
        for letter in line.chars() {
            let raster = get_raster(letter, FontWeight::Regular, HEIGHT)
                .or_else(|| get_raster('?', FontWeight::Regular, HEIGHT))
                .expect("the font has ASCII letters");
            for (row, intensities) in raster.rows().enumerate() {
                for (column, &intensity) in intensities.iter().enumerate() {
                    picture.blend([x + column, y + row], colour, intensity);
                }
            }
            x += raster.width();
        }
    }
}
