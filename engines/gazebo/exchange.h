// The exchange of one tick with skyrange: inputs in, forces on the aircraft in every step, states and contacts out.
// SPDX-License-Identifier: MIT
#ifndef SKYRANGE_GAZEBO_EXCHANGE_H
#define SKYRANGE_GAZEBO_EXCHANGE_H

#include <set>
#include <string>
#include <tuple>
#include <vector>

#include "multirotor_forces.h"
#include "protocol.h"

namespace skyrange
{

constexpr int32_t kFrame = -1;

// A collision shape: a part of an aircraft, or a building.
struct Part
{
    bool isAircraft = false;
    int32_t number = 0;     // of the aircraft, or of the building
    int32_t rotor = kFrame; // of an aircraft
};

// The number at the end of a name such as rotor_2; -1 if it does not begin with `prefix`.
inline int32_t NumberOf(const std::string &name, const std::string &prefix)
{
    if (name.compare(0, prefix.size(), prefix) != 0 || name.size() == prefix.size())
        return -1;
    int32_t number = 0;
    for (size_t k = prefix.size(); k < name.size(); ++k)
    {
        if (name[k] < '0' || name[k] > '9' || number > 100000000)
            return -1;
        number = 10 * number + (name[k] - '0');
    }
    return number;
}

class Exchange
{
  public:
    // Receives HELLO.
    Exchange() : hello(connection.ReceiveHello())
    {
        inputs.resize(hello.aircraft.size());
        for (auto &one : inputs)
            one.rotors.resize(hello.motors);
        states.resize(hello.aircraft.size());
        shown.resize(hello.shown.size());
    }

    // Before a physics step: waits for the next tick where one begins, and returns whether one does.
    bool BeginStep()
    {
        if (done != 0)
            return false;
        tick = connection.ReceiveStep(inputs, shown);
        contacts.clear();
        found.clear();
        return true;
    }

    // Force and torque on an aircraft in this step, in the local frame about its centre of gravity.
    Wrench ForcesNow(size_t i) const
    {
        const Wrench body = ForcesOn(hello.aircraft[i], inputs[i], states[i]);
        Wrench local{RotateToLocal(states[i], body.force), RotateToLocal(states[i], body.torque)};
        if (done == 0)
        {
            Add(local.force, inputs[i].impulse);
            Add(local.torque, inputs[i].angularImpulse);
        }
        return local;
    }

    // A contact in this step; the normal points from `two` to `one`. Of each pair of parts the first of a tick counts.
    void AddContact(const Part &one, const Part &two, const Vector &position, const Vector &normal, double depth)
    {
        if (!one.isAircraft && !two.isAircraft)
            return;
        if (!one.isAircraft || (two.isAircraft && two.number < one.number))
        {
            AddContact(two, one, position, {-normal.x, -normal.y, -normal.z}, depth);
            return;
        }
        const int32_t other = two.isAircraft ? two.number : -1 - two.number;
        if (!found.emplace(one.number, one.rotor, other, two.rotor).second)
            return;
        contacts.push_back(
            {static_cast<uint32_t>(one.number), other, one.rotor, two.rotor, position, normal, depth});
    }

    // After a physics step, whose states were written: answers where the tick ends.
    void EndStep()
    {
        if (++done < hello.steps)
            return;
        done = 0;
        connection.SendStepped(tick, states, contacts);
    }

    Connection connection;
    Hello hello;
    std::vector<Inputs> inputs;
    std::vector<Pose> shown;
    std::vector<State> states;

  private:
    void Add(Vector &to, const Vector &impulse) const
    {
        to.x += impulse.x / hello.step;
        to.y += impulse.y / hello.step;
        to.z += impulse.z / hello.step;
    }

    std::vector<Contact> contacts;
    std::set<std::tuple<int32_t, int32_t, int32_t, int32_t>> found;
    int64_t tick = 0;
    uint32_t done = 0;
};

}

#endif
