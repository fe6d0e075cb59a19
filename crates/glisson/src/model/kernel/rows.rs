//! The memory of a part: padded rows of its nodes, blocks of eight tetrahedra.

/// Rows that a part may have: two numbers of bits fewer than an offset holds, and small enough for a cache.
pub(super) const MOST_ROWS: usize = 1024;
/// Numbers in a row: x, y, z and a zero, so that one load fetches a node.
pub(super) const ROW: usize = 4;
/// Tetrahedra worked on side by side.
pub(super) const N_LANES: usize = 8;

const N_NUMBERS: usize = MOST_ROWS * ROW;
/// Keeps an offset inside the rows: the compiler sees that no access can miss, and checks none.
const OFFSET_MASK: usize = N_NUMBERS - ROW;

/// One padded vector.
pub(super) type Row = [f64; ROW];

/// Vectors on the nodes of a part: its own, then the borrowed ones.
#[derive(Clone, Debug)]
#[repr(C, align(64))]
pub(super) struct Rows([f64; N_NUMBERS]);

impl Rows {
    pub(super) fn zero() -> Box<Self> {
        Box::new(Self([0.0; N_NUMBERS]))
    }

    pub(super) fn all(&self) -> &[Row] {
        self.0.as_chunks().0
    }

    pub(super) fn all_mut(&mut self) -> &mut [Row] {
        self.0.as_chunks_mut().0
    }

    /// The row at an offset of [`offset_of`].
    #[inline(always)]
    pub(super) fn at(&self, offset: u16) -> &Row {
        let start = usize::from(offset) & OFFSET_MASK;
        (&self.0[start..start + ROW]).try_into().expect("a row's length")
    }

    /// The row at an offset of [`offset_of`].
    #[inline(always)]
    pub(super) fn at_mut(&mut self, offset: u16) -> &mut Row {
        let start = usize::from(offset) & OFFSET_MASK;
        (&mut self.0[start..start + ROW]).try_into().expect("a row's length")
    }
}

/// Offset of row `index`, multiplied beforehand.
pub(super) fn offset_of(index: usize) -> u16 {
    assert!(index < MOST_ROWS);
    u16::try_from(index * ROW).expect("offsets are below 4096")
}

/// Eight tetrahedra, one a lane, in the order in which the kernel reads them: 96 bytes a tetrahedron.
#[derive(Clone, Debug)]
#[repr(C, align(64))]
pub(super) struct Block {
    /// Offsets of the four nodes' rows, for each lane.
    pub(super) offsets: [[u16; 4]; N_LANES],
    /// alpha_1, alpha_2, alpha_3 [1/m], each x, y, z.
    pub(super) alpha_per_m: [[[f64; N_LANES]; 3]; 3],
    /// V lambda / 2 and V mu [N m].
    pub(super) material: [[f64; N_LANES]; 2],
}

impl Block {
    /// Lanes without a tetrahedron: they add zeros to the first row.
    pub(super) const EMPTY: Self = Self {
        offsets: [[0; 4]; N_LANES],
        alpha_per_m: [[[0.0; N_LANES]; 3]; 3],
        material: [[0.0; N_LANES]; 2],
    };

    /// Empties a lane. Its nodes stay named: they receive zeros.
    pub(super) fn clear(&mut self, lane: usize) {
        for number in self.alpha_per_m.iter_mut().flatten().chain(&mut self.material) {
            number[lane] = 0.0;
        }
    }
}
