//! The sheets of a mesh: what hangs together.

/// By vertex, the least vertex that it hangs together with through triangles.
pub fn sheets(vertices: usize, triangles: &[[u32; 3]]) -> Vec<u32> {
    let mut parents: Vec<u32> = (0..vertices as u32).collect();
    for &[a, b, c] in triangles {
        for other in [b, c] {
            let (a, b) = (root(&mut parents, a), root(&mut parents, other));
            parents[a.max(b) as usize] = a.min(b);
        }
    }
    (0..vertices as u32).map(|vertex| root(&mut parents, vertex)).collect()
}

/// Finds the root of a vertex, halving the way there.
fn root(parents: &mut [u32], mut vertex: u32) -> u32 {
    while parents[vertex as usize] != vertex {
        let above = parents[parents[vertex as usize] as usize];
        parents[vertex as usize] = above;
        vertex = above;
    }
    vertex
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn triangles_that_share_a_vertex_are_one_sheet_in_any_order() {
        assert!(sheets(0, &[]).is_empty());
        let mut triangles = [[6, 5, 4], [0, 1, 2], [7, 8, 9], [9, 3, 6]];
        for _ in 0..triangles.len() {
            triangles.rotate_left(1);
            assert_eq!(sheets(11, &triangles), [0, 0, 0, 3, 3, 3, 3, 3, 3, 3, 10]);
        }
    }
}
