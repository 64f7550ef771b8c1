// Forces on a multirotor: those of skyrange's own physics (src/skyrange/world/multirotor.py), without the ground.
// SPDX-License-Identifier: MIT
#ifndef SKYRANGE_MULTIROTOR_FORCES_H
#define SKYRANGE_MULTIROTOR_FORCES_H

#include <cmath>

#include "protocol.h"

namespace skyrange
{

// Force and torque in the body frame (forward-left-up) about the centre of gravity.
struct Wrench
{
    Vector force, torque;
};

inline Vector RotateToLocal(const State &state, const Vector &v)
{
    const double tx = 2.0 * (state.y * v.z - state.z * v.y);
    const double ty = 2.0 * (state.z * v.x - state.x * v.z);
    const double tz = 2.0 * (state.x * v.y - state.y * v.x);
    return {v.x + state.w * tx + state.y * tz - state.z * ty, v.y + state.w * ty + state.z * tx - state.x * tz,
            v.z + state.w * tz + state.x * ty - state.y * tx};
}

inline Vector RotateToBody(const State &state, const Vector &v)
{
    State inverse = state;
    inverse.x = -state.x;
    inverse.y = -state.y;
    inverse.z = -state.z;
    return RotateToLocal(inverse, v);
}

// Thrust, drag torque, drag of rotors and body, and rotational drag.
inline Wrench ForcesOn(const Aircraft &aircraft, const Inputs &inputs, const State &state)
{
    double thrust = 0.0, turning = 0.0;
    Wrench wrench;
    for (size_t m = 0; m < aircraft.rotors.size(); ++m)
    {
        const double speed = inputs.rotors[m];
        const double force = aircraft.thrust * speed * speed;
        thrust += force;
        turning += speed;
        wrench.torque.x += aircraft.rotors[m].left * force;
        wrench.torque.y -= aircraft.rotors[m].forward * force;
        wrench.torque.z -= aircraft.rotors[m].spin * aircraft.torqueArm * force;
    }
    const Vector through{state.velocity.x - inputs.air.x, state.velocity.y - inputs.air.y,
                         state.velocity.z - inputs.air.z};
    const Vector across = RotateToBody(state, through);
    const double body =
        aircraft.bodyDrag * std::sqrt(across.x * across.x + across.y * across.y + across.z * across.z);
    const double rotor = aircraft.rotorDrag * turning;
    wrench.force = {-(body + rotor) * across.x, -(body + rotor) * across.y, thrust - body * across.z};
    wrench.torque.x -= aircraft.spinDrag * std::abs(state.rates.x) * state.rates.x;
    wrench.torque.y -= aircraft.spinDrag * std::abs(state.rates.y) * state.rates.y;
    wrench.torque.z -= aircraft.spinDrag * std::abs(state.rates.z) * state.rates.z;
    return wrench;
}

}

#endif
