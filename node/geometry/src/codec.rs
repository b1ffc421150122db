//! Decoding of vertices and indices compressed by meshoptimizer (EXT_meshopt_compression, appendices
//! A and B), with the checks that the foreign code leaves to its caller.
//!
//! That code is safe for any encoded bytes, but asserts on counts and strides that no encoder writes,
//! and a caller must have allocated the result before. So a claimed count is held against the fewest
//! bytes that can encode it.

/// What turns decoded elements into numbers (EXT_meshopt_compression, appendix B).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Filter {
    /// Unit vectors, in 4 or 8 bytes.
    Octahedral,
    /// Unit quaternions, in 8 bytes.
    Quaternion,
    /// Floats, in any number of words.
    Exponential,
    /// Colours, in 4 or 8 bytes (KHR_meshopt_compression).
    Color,
}

/// Why bytes cannot be decoded.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CodecError {
    /// The codec knows no elements of this size.
    #[error("compressed elements of {stride} bytes do not exist in this mode")]
    Stride {
        /// Bytes an element.
        stride: usize,
    },
    /// The claim cannot be true.
    #[error("{encoded} compressed bytes cannot hold {count} elements")]
    Count {
        /// Bytes there are.
        encoded: usize,
        /// Elements claimed.
        count: usize,
    },
    /// The bytes are no result of the encoder.
    #[error("its compressed bytes are broken")]
    Broken,
}

/// A vertex of `N` words.
#[derive(Clone, Copy)]
struct Words<const N: usize>([u32; N]);

impl<const N: usize> Default for Words<N> {
    fn default() -> Self {
        Self([0; N])
    }
}

/// Decodes `count` vertices of `stride` bytes each.
///
/// # Errors
/// See [`CodecError`]; at most 1024 bytes are allocated for each encoded one.
pub fn decode_vertices(
    encoded: &[u8],
    count: usize,
    stride: usize,
    filter: Option<Filter>,
) -> Result<Vec<u8>, CodecError> {
    let fits_filter = match filter {
        None | Some(Filter::Exponential) => true,
        Some(Filter::Octahedral | Filter::Color) => stride == 4 || stride == 8,
        Some(Filter::Quaternion) => stride == 8,
    };
    if stride == 0 || stride > 256 || !stride.is_multiple_of(4) || !fits_filter {
        return Err(CodecError::Stride { stride });
    }
    // The newest codec spends two bits on a lane of a block of 256 vertices at the least.
    let least = count.div_ceil(256).checked_mul(stride / 4);
    if least.is_none_or(|least| least > encoded.len()) {
        return Err(CodecError::Count { encoded: encoded.len(), count });
    }
    macro_rules! by_words {
        ($($words:literal)*) => {
            match stride / 4 {
                $($words => vertices::<$words>(encoded, count, filter),)*
                _ => Err(CodecError::Stride { stride }),
            }
        };
    }
    by_words!(1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18 19 20 21 22 23 24 25 26 27 28 29 30 31 32
        33 34 35 36 37 38 39 40 41 42 43 44 45 46 47 48 49 50 51 52 53 54 55 56 57 58 59 60 61 62 63 64)
}

fn vertices<const N: usize>(
    encoded: &[u8],
    count: usize,
    filter: Option<Filter>,
) -> Result<Vec<u8>, CodecError> {
    let decoded: Vec<Words<N>> =
        meshopt::decode_vertex_buffer(encoded, count).map_err(|_| CodecError::Broken)?;
    let mut bytes: Vec<u8> =
        decoded.iter().flat_map(|words| words.0).flat_map(u32::to_ne_bytes).collect();
    drop(decoded);
    match filter {
        None => {}
        Some(Filter::Exponential) => {
            mapped(&mut bytes, u32::from_ne_bytes, u32::to_ne_bytes, |w| {
                // One lane at a time: the filter treats each by itself.
                meshopt::decode_filter_exp::<1>(w);
            })
        }
        Some(Filter::Octahedral) if N == 1 => {
            meshopt::decode_filter_oct::<u8>(bytes.as_chunks_mut().0)
        }
        Some(Filter::Color) if N == 1 => {
            meshopt::decode_filter_color::<u8>(bytes.as_chunks_mut().0)
        }
        Some(Filter::Octahedral) => mapped(&mut bytes, u16::from_ne_bytes, u16::to_ne_bytes, |v| {
            meshopt::decode_filter_oct::<u16>(v);
        }),
        Some(Filter::Color) => mapped(&mut bytes, u16::from_ne_bytes, u16::to_ne_bytes, |v| {
            meshopt::decode_filter_color::<u16>(v);
        }),
        Some(Filter::Quaternion) => mapped(&mut bytes, i16::from_ne_bytes, i16::to_ne_bytes, |v| {
            meshopt::decode_filter_quat(v);
        }),
    }
    Ok(bytes)
}

/// Runs a filter over `bytes` as elements of `LANES` numbers of `SIZE` bytes.
fn mapped<T: Copy, const SIZE: usize, const LANES: usize>(
    bytes: &mut [u8],
    read: impl Fn([u8; SIZE]) -> T,
    write: impl Fn(T) -> [u8; SIZE],
    filter: impl Fn(&mut [[T; LANES]]),
) {
    /// Elements at once, so that little is copied twice.
    const ELEMENTS: usize = 4096;
    for part in bytes.chunks_mut(ELEMENTS * LANES * SIZE) {
        let lanes: Vec<T> = part.as_chunks::<SIZE>().0.iter().map(|lane| read(*lane)).collect();
        let mut elements: Vec<[T; LANES]> = lanes.as_chunks::<LANES>().0.to_vec();
        filter(&mut elements);
        for (lane, value) in part.as_chunks_mut::<SIZE>().0.iter_mut().zip(elements.as_flattened())
        {
            *lane = write(*value);
        }
    }
}

/// Decodes `count` indices of triangles into `stride` bytes each, 2 or 4.
///
/// # Errors
/// See [`CodecError`]. An index may still be beyond the vertices.
pub fn decode_triangles(
    encoded: &[u8],
    count: usize,
    stride: usize,
) -> Result<Vec<u8>, CodecError> {
    // A byte for each triangle.
    if !count.is_multiple_of(3) || count / 3 > encoded.len() {
        return Err(CodecError::Count { encoded: encoded.len(), count });
    }
    match stride {
        2 => meshopt::decode_index_buffer::<u16>(encoded, count).map(|indices| narrow(&indices)),
        4 => meshopt::decode_index_buffer::<u32>(encoded, count).map(|indices| wide(&indices)),
        _ => return Err(CodecError::Stride { stride }),
    }
    .map_err(|_| CodecError::Broken)
}

/// Decodes `count` indices in any order into `stride` bytes each, 2 or 4.
///
/// # Errors
/// See [`CodecError`]. An index may still be beyond the vertices.
pub fn decode_indices(encoded: &[u8], count: usize, stride: usize) -> Result<Vec<u8>, CodecError> {
    // A byte for each index.
    if count > encoded.len() {
        return Err(CodecError::Count { encoded: encoded.len(), count });
    }
    match stride {
        2 => meshopt::decode_index_sequence::<u16>(encoded, count).map(|indices| narrow(&indices)),
        4 => meshopt::decode_index_sequence::<u32>(encoded, count).map(|indices| wide(&indices)),
        _ => return Err(CodecError::Stride { stride }),
    }
    .map_err(|_| CodecError::Broken)
}

fn narrow(indices: &[u16]) -> Vec<u8> {
    indices.iter().flat_map(|index| index.to_le_bytes()).collect()
}

fn wide(indices: &[u32]) -> Vec<u8> {
    indices.iter().flat_map(|index| index.to_le_bytes()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn vertex(i: u32) -> [u32; 3] {
        [i, 3 * i, 7]
    }

    #[test]
    fn nothing_decodes_to_nothing_and_claims_are_held_against_the_bytes() {
        assert_eq!(decode_vertices(&[], 0, 12, None), Err(CodecError::Broken));
        for count in [1 << 20, usize::MAX] {
            let error = CodecError::Count { encoded: 4, count };
            assert_eq!(decode_vertices(&[0xa0; 4], count, 12, None), Err(error));
            assert_eq!(decode_indices(&[0xd1; 4], count, 4), Err(error));
            let count = count / 3 * 3;
            let error = CodecError::Count { encoded: 4, count };
            assert_eq!(decode_triangles(&[0xe1; 4], count, 2), Err(error));
        }
        assert!(decode_triangles(&[0xe1; 40], 4, 2).is_err());
    }

    #[test]
    fn sizes_that_the_codec_would_stop_the_process_for_are_refused() {
        for stride in [0, 2, 6, 260, usize::MAX] {
            let error = Err(CodecError::Stride { stride });
            assert_eq!(decode_vertices(&[0xa0; 64], 1, stride, None), error);
        }
        for (stride, filter) in
            [(12, Filter::Octahedral), (4, Filter::Quaternion), (16, Filter::Color)]
        {
            let error = Err(CodecError::Stride { stride });
            assert_eq!(decode_vertices(&[0xa0; 64], 1, stride, Some(filter)), error);
        }
        for stride in [0, 1, 3, 8] {
            assert_eq!(decode_triangles(&[0; 9], 3, stride), Err(CodecError::Stride { stride }));
            assert_eq!(decode_indices(&[0; 9], 3, stride), Err(CodecError::Stride { stride }));
        }
    }

    #[test]
    fn what_was_encoded_comes_back() {
        let vertices: Vec<[u32; 3]> = (0..1000).map(vertex).collect();
        let encoded = meshopt::encode_vertex_buffer(&vertices).unwrap();
        let bytes: Vec<u8> = vertices.iter().flatten().flat_map(|w| w.to_ne_bytes()).collect();
        assert_eq!(decode_vertices(&encoded, 1000, 12, None).unwrap(), bytes);
        let indices: Vec<u32> = (0..300).map(|i| i / 3 + i % 3).collect();
        let triangles = meshopt::encode_index_buffer(&indices, 102).unwrap();
        // A triangle may come back turned, but not another one.
        let decoded = decode_triangles(&triangles, 300, 4).unwrap();
        assert_eq!(decoded.len(), 1200);
        assert_eq!(decode_triangles(&triangles, 300, 2).unwrap().len(), 600);
        let sequence = meshopt::encode_index_sequence(&indices, 102).unwrap();
        assert_eq!(decode_indices(&sequence, 300, 4).unwrap(), wide(&indices));
    }

    #[test]
    fn all_zero_vertices_pass_the_check_of_the_count() {
        for version in [Some(0), Some(1)] {
            let encoded =
                meshopt::encode_vertex_buffer_level(&vec![[0u32; 2]; 100_000], 3, version).unwrap();
            assert_eq!(decode_vertices(&encoded, 100_000, 8, None).unwrap(), vec![0; 800_000]);
        }
    }

    #[test]
    fn filters_give_back_unit_vectors_and_floats() {
        let axes = [[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0], [0.6, 0.8, 0.0, 0.0]];
        let oct8: Vec<[u8; 4]> = meshopt::encode_filter_oct(&axes, 8);
        let bytes = meshopt::encode_vertex_buffer(&oct8).unwrap();
        let decoded = decode_vertices(&bytes, 3, 4, Some(Filter::Octahedral)).unwrap();
        assert_eq!((decoded[0] as i8, decoded[6] as i8), (127, -127));
        let oct16: Vec<[u16; 4]> = meshopt::encode_filter_oct(&axes, 16);
        let bytes = meshopt::encode_vertex_buffer(&oct16).unwrap();
        let decoded = decode_vertices(&bytes, 3, 8, Some(Filter::Octahedral)).unwrap();
        assert_eq!(i16::from_ne_bytes([decoded[0], decoded[1]]), 32767);
        let turns = meshopt::encode_filter_quat(&[[0.0, 0.0, 0.0, 1.0]], 12);
        let bytes = meshopt::encode_vertex_buffer(&turns).unwrap();
        let decoded = decode_vertices(&bytes, 1, 8, Some(Filter::Quaternion)).unwrap();
        assert_eq!(i16::from_ne_bytes([decoded[6], decoded[7]]).abs(), 32767);
        let floats = meshopt::encode_filter_exp(
            &[[1.5f32, -2.0, 1e6]],
            20,
            meshopt::EncodeExpMode::Separate,
        );
        let bytes = meshopt::encode_vertex_buffer(&floats).unwrap();
        let decoded = decode_vertices(&bytes, 1, 12, Some(Filter::Exponential)).unwrap();
        let value = |at: usize| f32::from_ne_bytes(*decoded[at..].first_chunk().unwrap());
        assert_eq!([value(0), value(4), value(8)], [1.5, -2.0, 1e6]);
    }

    #[test]
    fn no_truncation_and_no_flipped_byte_stops_the_process() {
        let vertices: Vec<[u32; 3]> = (0..300).map(vertex).collect();
        let indices: Vec<u32> = (0..300).map(|i| i / 3 + i % 3).collect();
        let whole = meshopt::encode_vertex_buffer(&vertices).unwrap();
        let triangles = meshopt::encode_index_buffer(&indices, 102).unwrap();
        let sequence = meshopt::encode_index_sequence(&indices, 102).unwrap();
        for end in 0..whole.len() {
            assert!(decode_vertices(&whole[..end], 300, 12, None).is_err(), "cut at {end}");
        }
        for bytes in [&whole, &triangles, &sequence] {
            for place in 0..bytes.len() {
                let mut broken = bytes.clone();
                broken[place] ^= 0xA5;
                let _ = decode_vertices(&broken, 300, 12, Some(Filter::Exponential));
                let _ = decode_triangles(&broken, 300, 2);
                let _ = decode_indices(&broken, 300, 4);
            }
        }
    }
}
