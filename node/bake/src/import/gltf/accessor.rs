//! Typed, bounds-checked reading of accessors (glTF 2.0, section 3.6.2).
//!
//! An [`Accessor`] is checked once, against the bytes there are, when it is opened; after that any
//! range of its elements can be loaded.

use std::collections::HashMap;
use std::ops::Range;
use std::rc::Rc;
use std::sync::{Arc, Mutex};

use super::buffers::{Resources, Span};
use super::document::{AccessorDef, ElementType, SparseDef, label};
use crate::import::error::ImportError;

/// How one number of an element is stored.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Component {
    I8,
    U8,
    I16,
    U16,
    U32,
    F32,
}

impl Component {
    fn from_code(code: u64) -> Option<Self> {
        Some(match code {
            5120 => Self::I8,
            5121 => Self::U8,
            5122 => Self::I16,
            5123 => Self::U16,
            5125 => Self::U32,
            5126 => Self::F32,
            _ => return None,
        })
    }

    fn bytes(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::U32 | Self::F32 => 4,
        }
    }

    /// Lane `lane` of an element as a number, and as a fraction of the type's range where
    /// `normalized` (section 3.6.2.2). `u32` cannot be normalised.
    fn read(self, element: &[u8], lane: usize, normalized: bool) -> f32 {
        let (value, full) = match self {
            Self::F32 => return f32::from_le_bytes(element.as_chunks().0[lane]),
            Self::U32 => return u32::from_le_bytes(element.as_chunks().0[lane]) as f32,
            Self::I8 => (f32::from(element[lane] as i8), 127.0),
            Self::U8 => (f32::from(element[lane]), 255.0),
            Self::I16 => (f32::from(i16::from_le_bytes(element.as_chunks().0[lane])), 32767.0),
            Self::U16 => (f32::from(u16::from_le_bytes(element.as_chunks().0[lane])), 65535.0),
        };
        if normalized { (value / full).max(-1.0) } else { value }
    }

    /// An index. Signed and floating components are refused when an accessor is opened.
    fn read_index(self, element: &[u8]) -> u32 {
        match self {
            Self::U8 => u32::from(element[0]),
            Self::U16 => u32::from(u16::from_le_bytes(element.as_chunks().0[0])),
            Self::U32 => u32::from_le_bytes(element.as_chunks().0[0]),
            Self::I8 | Self::I16 | Self::F32 => {
                unreachable!("checked when the accessor was opened")
            }
        }
    }

    fn can_index(self) -> bool {
        matches!(self, Self::U8 | Self::U16 | Self::U32)
    }
}

/// What an accessor is to be used as; decides which types are fit for it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Role {
    /// Vertex numbers: unsigned scalars.
    Indices,
    /// Three lanes, any component that KHR_mesh_quantization allows.
    Position,
    /// Three lanes; integers are always fractions.
    Normal,
    /// Three or four lanes; integers are always fractions.
    Color,
    /// Two lanes, any component that KHR_mesh_quantization allows.
    TexCoord,
    /// Translation or scale of an instance: three lanes, any component but an index.
    Vector,
    /// Rotation of an instance: four lanes; integers are always fractions.
    Rotation,
}

impl Role {
    fn fits(self, component: Component, lanes: usize) -> bool {
        match self {
            Self::Indices => lanes == 1 && component.can_index(),
            _ if component == Component::U32 => false,
            Self::Position | Self::Normal | Self::Vector => lanes == 3,
            Self::Color => lanes == 3 || lanes == 4,
            Self::TexCoord => lanes == 2,
            Self::Rotation => lanes == 4,
        }
    }

    /// Whether integers are fractions of their range even where the file does not say so.
    fn is_always_fraction(self) -> bool {
        matches!(self, Self::Normal | Self::Color | Self::Rotation)
    }
}

/// Elements that replace those of the base, by strictly rising index.
struct Sparse {
    indices: Vec<u32>,
    values: Vec<u8>,
}

/// Sparse elements by accessor: read once, however many primitives use them.
#[derive(Default)]
pub(super) struct SparseElements(Mutex<HashMap<usize, Arc<Sparse>>>);

impl SparseElements {
    fn of(
        &self,
        accessor: usize,
        open: impl FnOnce() -> Result<Sparse, ImportError>,
    ) -> Result<Arc<Sparse>, ImportError> {
        let mut known = self.0.lock().expect("nobody panics while it is held");
        if let Some(sparse) = known.get(&accessor) {
            return Ok(Arc::clone(sparse));
        }
        let sparse = Arc::new(open()?);
        known.insert(accessor, Arc::clone(&sparse));
        Ok(sparse)
    }
}

/// How elements are stored.
#[derive(Clone, Copy)]
struct Layout {
    stride: usize,
    element_bytes: usize,
    component: Component,
    lanes: usize,
    normalized: bool,
}

/// An accessor whose every element is known to be there.
pub(super) struct Accessor {
    /// From the first element on; `None`: all zero but for the sparse elements.
    base: Option<Span>,
    layout: Layout,
    sparse: Option<Arc<Sparse>>,
    /// How many elements it has.
    pub(super) count: usize,
}

/// Which elements of an accessor are loaded, in rising order.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Numbers {
    /// All of a range.
    Range(Range<usize>),
    /// Some that lie far apart.
    Picked(Rc<[u32]>),
}

impl Numbers {
    /// How many there are.
    pub(super) fn len(&self) -> usize {
        match self {
            Self::Range(range) => range.len(),
            Self::Picked(numbers) => numbers.len(),
        }
    }

    /// The number in the accessor of the one at `place`.
    pub(super) fn number(&self, place: usize) -> usize {
        match self {
            Self::Range(range) => range.start + place,
            Self::Picked(numbers) => numbers[place] as usize,
        }
    }

    /// Where the element with this number is, which must be among them.
    pub(super) fn place(&self, number: usize) -> usize {
        match self {
            Self::Range(range) => number - range.start,
            Self::Picked(numbers) => numbers.partition_point(|&other| (other as usize) < number),
        }
    }
}

/// Some elements of an accessor, in memory: numbered by their places, from 0.
pub(super) struct Elements {
    base: Option<Vec<u8>>,
    layout: Layout,
    sparse: Option<Arc<Sparse>>,
    numbers: Numbers,
}

const ZERO_ELEMENT: [u8; 16] = [0; 16];
/// Elements that are read in vain at most to spare another read.
const MOST_SKIPPED: u32 = 64;

impl Accessor {
    /// Opens accessor `number` for `role`; `user` names who refers to it, for messages.
    pub(super) fn open(
        resources: &Resources<'_>,
        user: &str,
        number: usize,
        role: Role,
    ) -> Result<Self, ImportError> {
        let all = &resources.document.accessors;
        let Some(def) = all.get(number) else {
            return Err(
                resources.broken(user, format!("it refers to accessor {number} of {}", all.len()))
            );
        };
        let at = format!("{user}, {}", label("accessor", number, def.name.as_ref()));
        let (component, lanes) = element_type(def)
            .filter(|&(component, lanes)| role.fits(component, lanes))
            .ok_or_else(|| {
                let found = format!(
                    "component type {}, type {:?}",
                    def.component_type,
                    def.element_type.name()
                );
                resources.broken(&at, format!("{found} cannot be used as {role:?}"))
            })?;
        let element_bytes = component.bytes() * lanes;
        let (base, stride) = match def.buffer_view {
            Some(view) => base(resources, &at, def, view, element_bytes)?,
            None if def.sparse.is_none() => {
                let what =
                    "it has no data of its own: no buffer view and no sparse elements".into();
                return Err(resources.invalid(at, what, "export without mesh compression"));
            }
            // Zeros cost no bytes, so only the size of the file bounds what may be claimed.
            None if def.count as u64 > resources.total_bytes() => {
                return Err(resources.broken(
                    &at,
                    format!("it claims {} elements and has no buffer view", def.count),
                ));
            }
            None => (None, element_bytes),
        };
        let open =
            |sparse: &SparseDef| open_sparse(resources, &at, sparse, def.count, element_bytes);
        let sparse = def.sparse.as_ref().map(|sparse| resources.sparse.of(number, || open(sparse)));
        let sparse = sparse.transpose()?;
        let normalized = def.normalized || role.is_always_fraction();
        let layout = Layout { stride, element_bytes, component, lanes, normalized };
        Ok(Self { base, layout, sparse, count: def.count })
    }

    /// Reads the elements of `numbers`, which must be below `count`.
    pub(super) fn load(
        self,
        resources: &Resources<'_>,
        numbers: Numbers,
    ) -> Result<Elements, ImportError> {
        let Self { base, mut layout, sparse, .. } = self;
        let stored = |range: Range<usize>| {
            let Some(span) = base.filter(|_| !range.is_empty()) else { return Ok(Vec::new()) };
            let length = (range.len() - 1) * layout.stride + layout.element_bytes;
            let part = span.part(range.start * layout.stride, length);
            resources.bytes(part.expect("all elements were found when it was opened"))
        };

        let bytes = match &numbers {
            Numbers::Range(range) => stored(range.clone())?,
            Numbers::Picked(picked) => {
                let mut bytes = Vec::with_capacity(picked.len() * layout.element_bytes);
                for run in picked.chunk_by(|one, next| next - one <= MOST_SKIPPED) {
                    let first = run[0] as usize;
                    let read = stored(first..run[run.len() - 1] as usize + 1)?;
                    let start = |number: u32| (number as usize - first) * layout.stride;
                    let found = run.iter().map(|&number| &read[start(number)..]);
                    found.for_each(|found| bytes.extend(&found[..layout.element_bytes]));
                }
                bytes
            }
        };

        if matches!(numbers, Numbers::Picked(_)) {
            layout.stride = layout.element_bytes;
        }
        Ok(Elements { base: base.map(|_| bytes), layout, sparse, numbers })
    }

    /// Reads all elements.
    pub(super) fn load_all(self, resources: &Resources<'_>) -> Result<Elements, ImportError> {
        let all = Numbers::Range(0..self.count);
        self.load(resources, all)
    }
}

impl Elements {
    /// How many there are.
    pub(super) fn len(&self) -> usize {
        self.numbers.len()
    }

    /// Element `i` as an index.
    pub(super) fn index(&self, i: usize) -> u32 {
        self.layout.component.read_index(self.element(i))
    }

    /// The first `N` lanes of element `i`; a lane that the type lacks is one, as alpha is.
    pub(super) fn vector<const N: usize>(&self, i: usize) -> [f32; N] {
        let element = self.element(i);
        std::array::from_fn(|lane| {
            if lane < self.layout.lanes {
                self.layout.component.read(element, lane, self.layout.normalized)
            } else {
                1.0
            }
        })
    }

    fn element(&self, i: usize) -> &[u8] {
        let bytes = self.layout.element_bytes;
        let number = || self.numbers.number(i);
        if let Some(sparse) = &self.sparse
            && let Ok(place) = sparse.indices.binary_search_by_key(&number(), |&i| i as usize)
        {
            return &sparse.values[place * bytes..][..bytes];
        }
        match &self.base {
            Some(base) => &base[i * self.layout.stride..][..bytes],
            None => &ZERO_ELEMENT[..bytes],
        }
    }
}

fn element_type(def: &AccessorDef) -> Option<(Component, usize)> {
    let ElementType::Lanes(lanes) = def.element_type else { return None };
    Some((Component::from_code(def.component_type)?, lanes))
}

/// Where the elements stand, and the step between them, once they are known to be there.
fn base(
    resources: &Resources<'_>,
    at: &str,
    def: &AccessorDef,
    view: usize,
    element_bytes: usize,
) -> Result<(Option<Span>, usize), ImportError> {
    let (span, stride) = resources.view(at, view)?;
    let stride = stride.unwrap_or(element_bytes);
    if stride < element_bytes {
        return Err(resources.broken(
            at,
            format!("its elements of {element_bytes} bytes overlap at stride {stride}"),
        ));
    }
    let needed = match def.count.checked_sub(1) {
        None => Some(0),
        Some(steps) => steps.checked_mul(stride).and_then(|bytes| bytes.checked_add(element_bytes)),
    };
    let found = needed.and_then(|needed| span.part(def.byte_offset, needed)).ok_or_else(|| {
        let (count, offset, has) = (def.count, def.byte_offset, span.length);
        let what = format!("it claims {count} elements, {stride} bytes apart, at byte {offset} of a view of {has} bytes");
        resources.broken(at, what)
    })?;
    Ok((Some(found), stride))
}

fn open_sparse(
    resources: &Resources<'_>,
    at: &str,
    def: &SparseDef,
    elements: usize,
    element_bytes: usize,
) -> Result<Sparse, ImportError> {
    let part = |view: usize, offset: usize, each: usize, name: &str| {
        let span = resources.view(at, view)?.0;
        let part = def.count.checked_mul(each).and_then(|needed| span.part(offset, needed));
        let part = part.ok_or_else(|| {
            let (count, has) = (def.count, span.length);
            let what = format!(
                "it claims {count} sparse {name}, at byte {offset} of a view of {has} bytes"
            );
            resources.broken(at, what)
        })?;
        resources.bytes(part)
    };
    let component = Component::from_code(def.indices.component_type)
        .filter(|component| component.can_index())
        .ok_or_else(|| {
            resources.broken(
                at,
                format!("its sparse indices have component type {}", def.indices.component_type),
            )
        })?;
    let places =
        part(def.indices.buffer_view, def.indices.byte_offset, component.bytes(), "indices")?;
    let values = part(def.values.buffer_view, def.values.byte_offset, element_bytes, "values")?;
    let indices: Vec<u32> = places
        .chunks_exact(component.bytes())
        .map(|element| component.read_index(element))
        .collect();
    if !indices.is_sorted_by(|a, b| a < b) {
        return Err(resources.broken(at, "its sparse indices do not rise".into()));
    }
    if let Some(&last) = indices.last().filter(|&&last| last as usize >= elements) {
        return Err(resources
            .broken(at, format!("its sparse index {last} is beyond its {elements} elements")));
    }
    Ok(Sparse { indices, values })
}
