//! Where a thread passes through tissue: through holes in its surface and, between them, through places inside, all of which go with
//! the tissue while the thread slides through them.

use crate::math::DVec3;
use crate::mesh::edit::EditableMesh;
use crate::suture::Rod;
use crate::world::organ::Organ;
use crate::world::site::{Site, site_of};
use crate::world::suture_spec::SutureError;

/// Places inside tissue are so far apart along the thread [m]: a choice, about an edge of a mesh.
pub(super) const INNER_M: f64 = 4e-3;
/// Passages of a thread at most: their nodes are a patch that models tell the answer of.
pub(super) const MOST_PASSAGES: usize = 20;
/// A path is looked at in steps of this length where it runs in tissue [m]: a choice.
const LOOKS_M: f64 = 5e-4;
/// How often the place of a hole is halved.
const HALVINGS: usize = 14;

/// A place of the tissue that a thread passes through.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Passage {
    pub(super) site: Site,
    /// The same in the rest shape [m].
    pub(super) rest_m: DVec3,
    /// Which place of the thread is there: its way from the first end [m].
    pub(super) along_m: f64,
    /// Force of the thread on the tissue in the last step [N].
    pub(super) force_n: DVec3,
    /// Whether it is a hole in the surface; the thread is in tissue on one side of it.
    pub(super) is_hole: bool,
}

impl Passage {
    pub(super) fn new(body: &EditableMesh, site: Site, along_m: f64, is_hole: bool) -> Self {
        let rest_m = site.place_m(body, &body.mesh().positions_m);
        Self { site, rest_m, along_m, force_n: DVec3::ZERO, is_hole }
    }

    pub(super) fn numbers(&self) -> [f64; 13] {
        let [a, b, c, d] = self.site.weights;
        let hole = f64::from(u8::from(self.is_hole));
        let (f, rest) = (self.force_n, self.rest_m);
        let tet = f64::from(self.site.tet.0);
        [tet, a, b, c, d, self.along_m, f.x, f.y, f.z, hole, rest.x, rest.y, rest.z]
    }
}

/// Whether the thread is in tissue at so much of its way, when its first end is or not.
pub(super) fn is_inside(passages: &[Passage], tip_is_inside: bool, along_m: f64) -> bool {
    let holes = passages.iter().filter(|passage| passage.is_hole && passage.along_m < along_m);
    tip_is_inside != (holes.count() % 2 == 1)
}

/// The passages of a thread that lies along its path in the rest shape, and whether its first end is in tissue.
///
/// # Errors
/// [`SutureError::TooLongInTissue`].
pub(super) fn laid(rod: &Rod, organ: &Organ) -> Result<(Vec<Passage>, bool), SutureError> {
    let body = organ.body();
    let at = |along_m: f64| rod.place_at(along_m).point_m(&rod.positions_m);
    let site = |along_m: f64| site_of(body, at(along_m));
    let (n_looks, length_m) = ((rod.length_m() / LOOKS_M).ceil() as usize, rod.length_m());
    let look_m = length_m / n_looks as f64;
    let tip_is_inside = site(0.0).is_some();
    let (mut holes, mut was_inside) = (Vec::new(), tip_is_inside);
    for look in 1..=n_looks {
        let along_m = look_m * look as f64;
        let is_inside = site(along_m).is_some();
        if is_inside != was_inside {
            // The place inside that is nearest to the surface.
            let (mut inside_m, mut outside_m) =
                if is_inside { (along_m, along_m - look_m) } else { (along_m - look_m, along_m) };
            for _ in 0..HALVINGS {
                let middle_m = 0.5 * (inside_m + outside_m);
                *(if site(middle_m).is_some() { &mut inside_m } else { &mut outside_m }) = middle_m;
            }
            holes.push(inside_m);
        }
        was_inside = is_inside;
    }
    let mut passages = Vec::new();
    let mut in_tissue_m = 0.0;
    let passage = |along_m: f64, is_hole| Some(Passage::new(body, site(along_m)?, along_m, is_hole));
    let mut inside_from_m = tip_is_inside.then_some(0.0);
    for &hole_m in holes.iter().chain(was_inside.then_some(&length_m)) {
        let Some(from_m) = inside_from_m.take() else {
            inside_from_m = Some(hole_m);
            passages.extend(passage(hole_m, true));
            continue;
        };
        in_tissue_m += hole_m - from_m;
        let n_pieces = ((hole_m - from_m) / INNER_M).ceil().max(1.0);
        let inner = (1..n_pieces as usize).map(|i| from_m + (hole_m - from_m) * i as f64 / n_pieces);
        passages.extend(inner.filter_map(|along_m| passage(along_m, false)));
        if hole_m < length_m {
            passages.extend(passage(hole_m, true));
        }
    }
    if passages.len() > MOST_PASSAGES {
        let (n, length_mm) = (passages.len(), 1e3 * in_tissue_m);
        return Err(SutureError::TooLongInTissue { length_mm, n, most: MOST_PASSAGES });
    }
    Ok((passages, tip_is_inside))
}

/// Follows an edit: places go with the tissue that is there now; those without are given up, and where that opens the tissue
/// between two holes, the next one inside becomes the hole. Allocates nothing.
pub(super) fn follow(passages: &mut Vec<Passage>, tip_is_inside: &mut bool, body: &EditableMesh) {
    let topology = body.topology();
    let mut kept: usize = 0;
    let mut is_in = *tip_is_inside;
    // Whether the tissue around the first end is gone: then it is outside, and what is left of its way in has to begin anew.
    let mut tip_is_bare = false;
    // Whether the hole that led in here is gone, so that the next place is one.
    let mut opened = false;
    for i in 0..passages.len() {
        let mut passage = passages[i];
        let is_live = passage.site.tet.index() < topology.n_tets() && topology.is_live_tet(passage.site.tet);
        let stays = is_live
            && passage.site.place_m(body, &body.mesh().positions_m).distance_squared(passage.rest_m) < 1e-16;
        let found = if stays { Some(passage.site) } else { site_of(body, passage.rest_m) };
        let was_hole = passage.is_hole;
        let Some(site) = found else {
            tip_is_bare |= *tip_is_inside && is_in && kept == 0;
            if was_hole {
                if is_in && !std::mem::take(&mut opened) {
                    // The way out is gone: the last place inside is it.
                    match kept.checked_sub(1).map(|last| &mut passages[last]) {
                        Some(last) if !last.is_hole => last.is_hole = true,
                        // Nothing is left between: nor is the way in.
                        Some(_) => kept -= 1,
                        None => {}
                    }
                } else if !is_in {
                    opened = true;
                }
                is_in = !is_in;
            }
            continue;
        };
        if std::mem::take(&mut tip_is_bare) {
            *tip_is_inside = false;
            if was_hole && is_in {
                is_in = false;
                continue;
            }
            opened = is_in;
        }
        if opened && was_hole {
            // In and out of what is gone.
            opened = false;
            is_in = !is_in;
            continue;
        }
        passage.is_hole |= std::mem::take(&mut opened);
        is_in ^= was_hole;
        passage.site = site;
        passages[kept] = passage;
        kept += 1;
    }
    passages.truncate(kept);
    // Nothing is left that it could be in.
    *tip_is_inside &= !tip_is_bare && kept > 0;
}
