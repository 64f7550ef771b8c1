// A world plugin of Gazebo 11 that moves skyrange's aircraft, in lockstep with skyrange.
// SPDX-License-Identifier: MIT
#include <memory>
#include <unordered_map>

#include <gazebo/common/common.hh>
#include <gazebo/gazebo.hh>
#include <gazebo/physics/physics.hh>

#include "exchange.h"

namespace skyrange
{

class ClassicPlugin : public gazebo::WorldPlugin
{
  public:
    void Load(gazebo::physics::WorldPtr loaded, sdf::ElementPtr) override
    {
        world = loaded;
        if (!Connection::IsThere())
        {
            gzwarn << "skyrange: it has not started this Gazebo, so its aircraft stay at rest\n";
            return;
        }
        begin = gazebo::event::Events::ConnectWorldUpdateBegin([this](const auto &) { OnBegin(); });
        end = gazebo::event::Events::ConnectWorldUpdateEnd([this] { OnEnd(); });
    }

  private:
    void Open()
    {
        exchange = std::make_unique<Exchange>();
        const auto &hello = exchange->hello;
        for (size_t i = 0; i < hello.aircraft.size(); ++i)
        {
            const auto model = Find(hello.aircraft[i].model);
            const auto link = model->GetLink("body");
            if (!link)
                throw std::runtime_error("the model " + hello.aircraft[i].model + " has no link named body");
            links.push_back(link);
            for (const auto &collision : link->GetCollisions())
                parts[collision->GetId()] = {true, static_cast<int32_t>(i), NumberOf(collision->GetName(), "rotor_")};
        }
        for (const auto &name : hello.shown)
            shown.push_back(Find(name));
        for (const auto &model : world->Models())
            for (const auto &link : model->GetLinks())
                for (const auto &collision : link->GetCollisions())
                    if (NumberOf(collision->GetName(), "building_") >= 0)
                        parts[collision->GetId()] = {false, NumberOf(collision->GetName(), "building_"), kFrame};
        const auto physics = world->Physics();
        if (std::abs(physics->GetMaxStepSize() - hello.step) > 1e-9)
            throw std::runtime_error("the world's max_step_size is " + std::to_string(physics->GetMaxStepSize()));
        physics->GetContactManager()->SetNeverDropContacts(true);
        ReadStates();
        exchange->connection.SendReady(GAZEBO_VERSION_FULL, physics->GetType());
    }

    gazebo::physics::ModelPtr Find(const std::string &name)
    {
        const auto model = world->ModelByName(name);
        if (!model)
            throw std::runtime_error("the world has no model named " + name);
        return model;
    }

    void OnBegin()
    {
        try
        {
            if (!exchange)
                Open();
            if (exchange->BeginStep())
                for (size_t k = 0; k < shown.size(); ++k)
                {
                    const Pose &pose = exchange->shown[k];
                    shown[k]->SetWorldPose({pose.position.x, pose.position.y, pose.position.z, pose.w, pose.x, pose.y,
                                            pose.z});
                }
            for (size_t i = 0; i < links.size(); ++i)
            {
                const Wrench wrench = exchange->ForcesNow(i);
                links[i]->AddForce({wrench.force.x, wrench.force.y, wrench.force.z});
                links[i]->AddTorque({wrench.torque.x, wrench.torque.y, wrench.torque.z});
            }
        }
        catch (const std::exception &error)
        {
            Fail(error);
        }
    }

    void OnEnd()
    {
        try
        {
            ReadContacts();
            ReadStates();
            exchange->EndStep();
        }
        catch (const std::exception &error)
        {
            Fail(error);
        }
    }

    void ReadStates()
    {
        for (size_t i = 0; i < links.size(); ++i)
        {
            const auto pose = links[i]->WorldInertialPose();
            const auto velocity = links[i]->WorldCoGLinearVel();
            const auto rates = pose.Rot().RotateVectorReverse(links[i]->WorldAngularVel());
            State &state = exchange->states[i];
            state.position = {pose.Pos().X(), pose.Pos().Y(), pose.Pos().Z()};
            state.velocity = {velocity.X(), velocity.Y(), velocity.Z()};
            state.w = pose.Rot().W();
            state.x = pose.Rot().X();
            state.y = pose.Rot().Y();
            state.z = pose.Rot().Z();
            state.rates = {rates.X(), rates.Y(), rates.Z()};
        }
    }

    void ReadContacts()
    {
        const auto manager = world->Physics()->GetContactManager();
        const auto &found = manager->GetContacts();
        for (unsigned int k = 0; k < manager->GetContactCount(); ++k)
        {
            const auto *contact = found[k];
            const auto one = parts.find(contact->collision1->GetId());
            const auto two = parts.find(contact->collision2->GetId());
            if (one == parts.end() || two == parts.end() || contact->count == 0)
                continue; // the ground, or a body that is not of the range
            int deepest = 0;
            for (int j = 1; j < contact->count; ++j)
                if (contact->depths[j] > contact->depths[deepest])
                    deepest = j;
            const auto &at = contact->positions[deepest];
            const auto &normal = contact->normals[deepest];
            exchange->AddContact(one->second, two->second, {at.X(), at.Y(), at.Z()},
                                 {normal.X(), normal.Y(), normal.Z()}, contact->depths[deepest]);
        }
    }

    [[noreturn]] void Fail(const std::exception &error)
    {
        gzerr << "skyrange: " << error.what() << "\n";
        if (exchange)
            exchange->connection.SendFailed(error.what());
        else
            Connection().SendFailed(error.what());
        _exit(1);
    }

    gazebo::physics::WorldPtr world;
    gazebo::event::ConnectionPtr begin, end;
    std::unique_ptr<Exchange> exchange;
    std::vector<gazebo::physics::LinkPtr> links;
    std::vector<gazebo::physics::ModelPtr> shown;
    std::unordered_map<uint32_t, Part> parts;
};

GZ_REGISTER_WORLD_PLUGIN(ClassicPlugin)

}
