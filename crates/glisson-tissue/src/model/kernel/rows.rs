//! The memory of a part: padded rows of its nodes, blocks of eight tetrahedra.

/// Largest number of rows of a part.
pub(super) const MOST_ROWS: usize = 1024;
/// Tetrahedra in one block.
pub(super) const N_LANES: usize = 8;
/// One number for each of eight tetrahedra.
pub(super) type LaneNumbers = [f64; N_LANES];

const ROW_BYTES: usize = size_of::<Row>();
/// A node's two rows: one cache line.
const NODE_BYTES: usize = 2 * ROW_BYTES;
const ROWS_BYTES: usize = MOST_ROWS * NODE_BYTES;

/// One padded vector: x, y, z and a zero, so that one load fetches it.
pub(super) type Row = [f64; 4];

/// Displacements and forces of the nodes of a part, side by side: own nodes, then borrowed ones.
///
/// Stored as bytes, and a little longer than its rows, so that every offset of 16 bits is valid: the compiler then omits
/// bounds checks. A displacement and a force are never a multiple of 4096 bytes apart, which would make a load wait for
/// an unrelated store.
#[derive(Clone, Debug)]
#[repr(C, align(64))]
pub(super) struct Rows([u8; ROWS_BYTES + NODE_BYTES]);

impl Rows {
    pub(super) fn zero() -> Box<Self> {
        Box::new(Self([0; ROWS_BYTES + NODE_BYTES]))
    }

    /// Displacement [m] and force [N] of each node.
    pub(super) fn nodes(&self) -> &[[Row; 2]] {
        bytemuck::cast_slice(&self.0[..ROWS_BYTES])
    }

    /// Displacement [m] and force [N] of each node.
    pub(super) fn nodes_mut(&mut self) -> &mut [[Row; 2]] {
        bytemuck::cast_slice_mut(&mut self.0[..ROWS_BYTES])
    }

    /// The bytes of the displacement at an offset of [`offset_of`].
    #[inline(always)]
    pub(super) fn displacement(&self, offset: u16) -> &[u8; ROW_BYTES] {
        let start = usize::from(offset);
        (&self.0[start..start + ROW_BYTES]).try_into().expect("a row's length")
    }

    /// The bytes of both rows at an offset of [`offset_of`]: displacement, then force.
    #[cfg(target_arch = "x86_64")]
    #[inline(always)]
    pub(super) fn node_mut(&mut self, offset: u16) -> &mut [u8; NODE_BYTES] {
        let start = usize::from(offset);
        (&mut self.0[start..start + NODE_BYTES]).try_into().expect("a node's length")
    }

    /// The bytes of the force at an offset of [`offset_of`].
    #[inline(always)]
    pub(super) fn force_mut(&mut self, offset: u16) -> &mut [u8; ROW_BYTES] {
        let start = usize::from(offset) + ROW_BYTES;
        (&mut self.0[start..start + ROW_BYTES]).try_into().expect("a row's length")
    }
}

/// Offset in bytes of node `index`.
pub(super) fn offset_of(index: usize) -> u16 {
    u16::try_from(index * NODE_BYTES).expect("a part has at most 1024 nodes")
}

/// LaneBlock tetrahedra, one per lane, in the order in which the kernel reads them: 96 bytes per tetrahedron.
#[derive(Clone, Debug)]
#[repr(C, align(64))]
pub(super) struct Block {
    /// Offsets of the four nodes, for each lane.
    pub(super) offsets: [[u16; 4]; N_LANES],
    /// alpha_1, alpha_2, alpha_3 [1/m], each x, y, z.
    pub(super) alpha_per_m: [[LaneNumbers; 3]; 3],
    /// Two numbers of the law [N m], see [`super::element::ElementLaw::numbers`].
    pub(super) material: [LaneNumbers; 2],
}

impl Block {
    /// A block without tetrahedra: its lanes add zeros to the first row.
    pub(super) const EMPTY: Self = Self {
        offsets: [[0; 4]; N_LANES],
        alpha_per_m: [[[0.0; N_LANES]; 3]; 3],
        material: [[0.0; N_LANES]; 2],
    };

    /// Empties a lane. It keeps its node offsets, to which it adds zeros.
    pub(super) fn clear(&mut self, lane: usize) {
        for number in self.alpha_per_m.iter_mut().flatten().chain(&mut self.material) {
            number[lane] = 0.0;
        }
    }
}
