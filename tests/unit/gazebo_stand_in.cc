// A stand-in for Gazebo: rigid bodies under the plugin's forces, by the integration of src/skyrange/world/multirotor.py.
// Its argument is a file of numbers for each aircraft: mass, three moments of inertia, and a state as in protocol.h.
// SPDX-License-Identifier: Apache-2.0
#include <fstream>

#include "exchange.h"

using namespace skyrange;

struct Body
{
    double mass;
    Vector inertia;
    State state;
};

static void Move(State &state, const Body &body, const Wrench &local, double step)
{
    const Vector torque = RotateToBody(state, local.torque);
    const Vector old = state.velocity;
    state.velocity.x += local.force.x / body.mass * step;
    state.velocity.y += local.force.y / body.mass * step;
    state.velocity.z += (local.force.z / body.mass - 9.80665) * step;
    state.position.x += 0.5 * (old.x + state.velocity.x) * step;
    state.position.y += 0.5 * (old.y + state.velocity.y) * step;
    state.position.z += 0.5 * (old.z + state.velocity.z) * step;
    const Vector j = body.inertia, w = state.rates;
    const auto change = [&](const Vector &r) {
        return Vector{(torque.x - (j.z - j.y) * r.y * r.z) / j.x, (torque.y - (j.x - j.z) * r.z * r.x) / j.y,
                      (torque.z - (j.y - j.x) * r.x * r.y) / j.z};
    };
    const Vector first = change(w);
    const Vector middle{w.x + 0.5 * step * first.x, w.y + 0.5 * step * first.y, w.z + 0.5 * step * first.z};
    const Vector second = change(middle);
    state.rates = {w.x + step * second.x, w.y + step * second.y, w.z + step * second.z};
}

int main(int, char **arguments)
{
    std::ifstream file(arguments[1], std::ios::binary);
    Exchange exchange;
    std::vector<Body> bodies(exchange.hello.aircraft.size());
    file.read(reinterpret_cast<char *>(bodies.data()), static_cast<std::streamsize>(bodies.size() * sizeof(Body)));
    for (size_t i = 0; i < bodies.size(); ++i)
        exchange.states[i] = bodies[i].state;
    exchange.connection.SendReady("stand-in", "none");
    for (;;)
    {
        if (exchange.BeginStep() && !exchange.hello.aircraft.empty())
            exchange.AddContact({false, 6, kFrame}, {true, 0, NumberOf("rotor_3", "rotor_")}, {1.0, 2.0, 3.0},
                                {0.0, 1.0, 0.0}, 0.5);
        for (size_t i = 0; i < bodies.size(); ++i)
            Move(exchange.states[i], bodies[i], exchange.ForcesNow(i), exchange.hello.step);
        exchange.EndStep();
    }
}
