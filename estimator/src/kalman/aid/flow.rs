//! Optical flow with the signs of [`FlowSample`](vehicle::FlowSample): with d = distance to the surface along body down,
//! `x = gyro_x - v_right / d` and `y = gyro_y + v_forward / d`.

use super::{Observation, attitude_row, cos_tilt_derivative};
use crate::kalman::{GYRO_BIAS, Nominal, POSITION, VELOCITY};
use nalgebra::Vector3;

/// Below this distance the image is out of focus and the flow meaningless, m (PMW3901: 80 mm).
pub const MIN_DISTANCE_M: f64 = 0.08;

/// Flow about body x and y, rad/s, for a raw gyro reading and a surface `ground_m` above home's floor.
/// None when the vehicle is too close to the surface.
#[must_use]
pub fn observe(state: &Nominal, gyro: &Vector3<f64>, ground_m: f64) -> Option<[Observation; 2]> {
    let cos_tilt = state.cos_tilt().max(0.1);
    let height = -state.position.z - ground_m;
    let distance = height / cos_tilt;
    if distance < MIN_DISTANCE_M {
        return None;
    }
    let body = state.attitude.inverse() * state.velocity;
    let to_body = state.rotation().transpose();
    // Exp(-e) v = v + [v]x e to first order.
    let by_attitude = body.cross_matrix();
    let scalar = |axis: usize, sign: f64, gyro_axis: usize| {
        let speed = sign * body[axis];
        // speed / distance = speed * cos_tilt / height
        let mut row = attitude_row(
            by_attitude.row(axis).transpose() * (sign / distance)
                + cos_tilt_derivative(state) * (speed / height),
        );
        for i in 0..3 {
            row[VELOCITY + i] = sign * to_body[(axis, i)] / distance;
        }
        row[POSITION + 2] = speed * cos_tilt / (height * height);
        row[GYRO_BIAS + gyro_axis] = -1.0;
        Observation::new(
            gyro[gyro_axis] - state.gyro_bias[gyro_axis] + speed / distance,
            row,
        )
    };
    Some([scalar(1, -1.0, 0), scalar(0, 1.0, 1)])
}
