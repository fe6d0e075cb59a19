//! A motion imposed on a point of a triangle, spread over the triangle's vertices.
//!
//! The contact point c = sum_v k_v x_v follows a motion d exactly when each vertex v moves by alpha_v d with
//! sum_v k_v alpha_v = 1. Cotin, Delingette and Ayache 1998 (RR-3511, s. 5) take
//! alpha_v = k_v + 1 - (k_1^2 + k_2^2 + k_3^2) (printed there without the parenthesis): a vertex hit moves alone, a
//! centroid hit moves the triangle rigidly.

/// Below this sum of squared weights of the free vertices the contact lies on held tissue: spreading the motion
/// would move a free vertex more than four times as far as the tool.
const SMALLEST_FREE_WEIGHT: f64 = 1.0 / 16.0;

/// How far each vertex moves for a unit motion of the contact point with barycentric weights `k`; a fixed vertex
/// does not move. `None` when the point lies (almost) on fixed vertices alone.
///
/// With a fixed vertex the weights are the smallest ones that hold the condition, k_v / sum_free k^2.
pub fn motion_weights(k: [f64; 3], fixed: [bool; 3]) -> Option<[f64; 3]> {
    let sum_of_squares = |skip: [bool; 3]| (0..3).filter(|&v| !skip[v]).map(|v| k[v] * k[v]).sum::<f64>();
    if fixed == [false; 3] {
        let all = sum_of_squares(fixed);
        return Some(k.map(|k_v| k_v + 1.0 - all));
    }
    let free = sum_of_squares(fixed);
    if free < SMALLEST_FREE_WEIGHT {
        return None;
    }
    Some([0, 1, 2].map(|v| if fixed[v] { 0.0 } else { k[v] / free }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_contact_point_follows_the_tool_exactly(
            a in 0.0f64..1.0, b in 0.0f64..1.0, fixed in any::<[bool; 3]>(),
        ) {
            let (u, v) = if a + b > 1.0 { (1.0 - a, 1.0 - b) } else { (a, b) };
            let k = [1.0 - u - v, u, v];
            if let Some(alpha) = motion_weights(k, fixed) {
                let followed: f64 = (0..3).map(|i| k[i] * alpha[i]).sum();
                prop_assert!((followed - 1.0).abs() < 1e-12);
                prop_assert!((0..3).all(|i| !fixed[i] || alpha[i] == 0.0));
                prop_assert!(alpha.iter().all(|w| (0.0..=4.0).contains(w)));
            } else {
                prop_assert!(fixed != [false; 3]);
            }
        }
    }

    #[test]
    fn a_vertex_moves_alone_and_a_centroid_moves_all() {
        assert_eq!(motion_weights([1.0, 0.0, 0.0], [false; 3]), Some([1.0, 0.0, 0.0]));
        let third = 1.0 / 3.0;
        let alpha = motion_weights([third; 3], [false; 3]).unwrap();
        assert!(alpha.iter().all(|w| (w - 1.0).abs() < 1e-15));
        assert_eq!(motion_weights([1.0, 0.0, 0.0], [true, false, false]), None);
    }
}
