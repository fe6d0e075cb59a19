//! What `glisson import` has to be told of pictures of slices.

use glisson::image::files::{RawSlices, SliceChannel, SliceOptions};

/// Options for a folder of pictures.
#[derive(Clone, Debug, clap::Args)]
pub(super) struct SliceArgs {
    /// Read a folder of pictures, one a slice (.png, .tif, or bytes: .raw, .rgb), in the order of the numbers in their
    /// names: the distances of columns, rows and slices in mm
    #[arg(long, value_name = "X,Y,Z", value_parser = numbers::<f64, 3>, conflicts_with_all = ["series", "list", "anonymize"])]
    spacing_mm: Option<[f64; 3]>,
    /// Of coloured slices, what becomes of the colours
    #[arg(long, value_enum, default_value_t, requires = "spacing_mm")]
    channel: Channel,
    /// Of slices without a header (.raw, .rgb): how many pixels each has
    #[arg(long, value_name = "COLUMNS,ROWS", value_parser = numbers::<usize, 2>, requires = "spacing_mm")]
    size: Option<[usize; 2]>,
    /// Slices without a header hold all red, then all green, then all blue
    #[arg(long, requires = "size")]
    planes: bool,
    /// The slice with the lowest number is the nearest to the head, not to the feet
    #[arg(long, requires = "spacing_mm")]
    head_first: bool,
}

/// What becomes of the colours of slices.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
enum Channel {
    /// 0.299 red + 0.587 green + 0.114 blue
    #[default]
    Luminance,
    Red,
    Green,
    Blue,
}

impl SliceArgs {
    /// What is said; none where the image is not a folder of pictures.
    pub(super) fn options(&self) -> Option<SliceOptions> {
        let channel = match self.channel {
            Channel::Luminance => SliceChannel::Luminance,
            Channel::Red => SliceChannel::Red,
            Channel::Green => SliceChannel::Green,
            Channel::Blue => SliceChannel::Blue,
        };
        let raw = self.size.map(|size| RawSlices { size, in_planes: self.planes });
        self.spacing_mm.map(|spacing_mm| SliceOptions {
            spacing_mm,
            channel,
            raw,
            head_first: self.head_first,
        })
    }
}

/// `N` numbers with commas between them.
fn numbers<T: std::str::FromStr, const N: usize>(text: &str) -> Result<[T; N], String> {
    let list: Result<Vec<T>, _> = text.split(',').map(|field| field.trim().parse()).collect();
    let list = list.ok().and_then(|list| <[T; N]>::try_from(list).ok());
    list.ok_or_else(|| format!("`{text}` is not {N} numbers with commas between them"))
}
