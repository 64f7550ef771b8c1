// A system plugin of Gazebo Sim (Harmonic or newer) that moves skyrange's aircraft, in lockstep with skyrange.
// SPDX-License-Identifier: MIT
#include <iostream>
#include <memory>
#include <string>
#include <unordered_map>
#include <vector>

#include <gz/math/Pose3.hh>
#include <gz/msgs/contact.pb.h>
#include <gz/msgs/contacts.pb.h>
#include <gz/plugin/Register.hh>
#include <gz/sim/Link.hh>
#include <gz/sim/Model.hh>
#include <gz/sim/System.hh>
#include <gz/sim/World.hh>
#include <gz/sim/components/Collision.hh>
#include <gz/sim/components/ContactSensorData.hh>
#include <gz/sim/components/Inertial.hh>
#include <gz/sim/components/Link.hh>
#include <gz/sim/components/Name.hh>
#include <gz/sim/components/ParentEntity.hh>
#include <gz/sim/components/PhysicsEnginePlugin.hh>
#include <gz/sim/config.hh>

#include "exchange.h"

namespace skyrange
{
namespace gazebo
{

namespace sim = gz::sim;

class Aircraft : public sim::System,
                 public sim::ISystemConfigure,
                 public sim::ISystemPreUpdate,
                 public sim::ISystemPostUpdate
{
  public:
    void Configure(const sim::Entity &entity, const std::shared_ptr<const sdf::Element> &,
                   sim::EntityComponentManager &, sim::EventManager &) override
    {
        world = sim::World(entity);
        started = Connection::IsThere();
        if (!started)
            std::cerr << "skyrange: it has not started this Gazebo, so its aircraft stay at rest" << std::endl;
    }

    void PreUpdate(const sim::UpdateInfo &info, sim::EntityComponentManager &ecm) override
    {
        if (!started || info.paused)
            return;
        try
        {
            if (!exchange)
                Open(info, ecm);
            if (exchange->BeginStep())
                for (size_t k = 0; k < shown.size(); ++k)
                {
                    const Pose &pose = exchange->shown[k];
                    shown[k].SetWorldPoseCmd(ecm, {pose.position.x, pose.position.y, pose.position.z, pose.w, pose.x,
                                                   pose.y, pose.z});
                }
            for (size_t i = 0; i < links.size(); ++i)
            {
                const Wrench wrench = exchange->ForcesNow(i);
                // AddWorldForce adds the torque of a force at the centre of gravity; AddWorldWrench has none of it
                links[i].AddWorldForce(ecm, {wrench.force.x, wrench.force.y, wrench.force.z});
                links[i].AddWorldWrench(ecm, gz::math::Vector3d::Zero,
                                        {wrench.torque.x, wrench.torque.y, wrench.torque.z});
            }
        }
        catch (const std::exception &error)
        {
            Fail(error);
        }
    }

    void PostUpdate(const sim::UpdateInfo &info, const sim::EntityComponentManager &ecm) override
    {
        if (!exchange || info.paused)
            return;
        try
        {
            ReadContacts(ecm);
            ReadStates(ecm);
            exchange->EndStep();
        }
        catch (const std::exception &error)
        {
            Fail(error);
        }
    }

  private:
    void Open(const sim::UpdateInfo &info, sim::EntityComponentManager &ecm)
    {
        exchange = std::make_unique<Exchange>();
        const auto &hello = exchange->hello;
        const double step = std::chrono::duration<double>(info.dt).count();
        if (std::abs(step - hello.step) > 1e-9)
            throw std::runtime_error("the world's max_step_size is " + std::to_string(step));
        for (size_t i = 0; i < hello.aircraft.size(); ++i)
        {
            const auto model = Find(ecm, hello.aircraft[i].model);
            sim::Link link(model.LinkByName(ecm, "body"));
            if (!link.Valid(ecm))
                throw std::runtime_error("the model " + hello.aircraft[i].model + " has no link named body");
            link.EnableVelocityChecks(ecm);
            links.push_back(link);
            const auto *inertial = ecm.Component<sim::components::Inertial>(link.Entity());
            centres.push_back(inertial == nullptr ? gz::math::Vector3d::Zero : inertial->Data().Pose().Pos());
            for (const auto collision : link.Collisions(ecm))
            {
                const auto *name = ecm.Component<sim::components::Name>(collision);
                parts[collision] = {true, static_cast<int32_t>(i),
                                    name == nullptr ? kFrame : NumberOf(name->Data(), "rotor_")};
                if (!ecm.EntityHasComponentType(collision, sim::components::ContactSensorData::typeId))
                    ecm.CreateComponent(collision, sim::components::ContactSensorData());
                touching.push_back(collision);
            }
        }
        for (const auto &name : hello.shown)
            shown.push_back(Find(ecm, name));
        ecm.Each<sim::components::Collision, sim::components::Name>(
            [this](const sim::Entity &collision, const sim::components::Collision *, const sim::components::Name *name)
            {
                if (NumberOf(name->Data(), "building_") >= 0)
                    parts[collision] = {false, NumberOf(name->Data(), "building_"), kFrame};
                return true;
            });
        ReadStates(ecm);
        exchange->connection.SendReady(GZ_SIM_VERSION_FULL, Physics(ecm));
    }

    sim::Model Find(const sim::EntityComponentManager &ecm, const std::string &name) const
    {
        const sim::Model model(world.ModelByName(ecm, name));
        if (!model.Valid(ecm))
            throw std::runtime_error("the world has no model named " + name);
        return model;
    }

    std::string Physics(const sim::EntityComponentManager &ecm) const
    {
        const auto *plugin = ecm.Component<sim::components::PhysicsEnginePlugin>(world.Entity());
        return plugin == nullptr ? "gz-physics-dartsim-plugin" : plugin->Data();
    }

    void ReadStates(const sim::EntityComponentManager &ecm)
    {
        for (size_t i = 0; i < links.size(); ++i)
        {
            const auto pose = links[i].WorldInertialPose(ecm);
            const auto velocity = links[i].WorldLinearVelocity(ecm, centres[i]);
            const auto spin = links[i].WorldAngularVelocity(ecm);
            State &state = exchange->states[i];
            if (!pose)
                throw std::runtime_error("the model " + exchange->hello.aircraft[i].model + " was removed");
            const auto turned = links[i].WorldPose(ecm)->Rot();
            state.position = {pose->Pos().X(), pose->Pos().Y(), pose->Pos().Z()};
            state.w = turned.W();
            state.x = turned.X();
            state.y = turned.Y();
            state.z = turned.Z();
            if (!velocity || !spin) // before the first step
                continue;
            const auto rates = turned.RotateVectorReverse(*spin);
            state.velocity = {velocity->X(), velocity->Y(), velocity->Z()};
            state.rates = {rates.X(), rates.Y(), rates.Z()};
        }
    }

    void ReadContacts(const sim::EntityComponentManager &ecm)
    {
        for (const auto collision : touching)
        {
            const auto *data = ecm.Component<sim::components::ContactSensorData>(collision);
            if (data == nullptr)
                continue;
            for (const auto &contact : data->Data().contact())
            {
                const auto one = parts.find(contact.collision1().id());
                const auto two = parts.find(contact.collision2().id());
                if (one == parts.end() || two == parts.end() || contact.position_size() == 0)
                    continue; // the ground, or a body that is not of the range
                int deepest = 0;
                for (int j = 1; j < std::min(contact.depth_size(), contact.position_size()); ++j)
                    if (contact.depth(j) > contact.depth(deepest))
                        deepest = j;
                const auto &at = contact.position(deepest);
                Vector normal;
                if (deepest < contact.normal_size())
                    normal = {contact.normal(deepest).x(), contact.normal(deepest).y(), contact.normal(deepest).z()};
                exchange->AddContact(one->second, two->second, {at.x(), at.y(), at.z()}, normal,
                                     deepest < contact.depth_size() ? contact.depth(deepest) : 0.0);
            }
        }
    }

    [[noreturn]] void Fail(const std::exception &error)
    {
        std::cerr << "skyrange: " << error.what() << std::endl;
        if (exchange)
            exchange->connection.SendFailed(error.what());
        else
            Connection().SendFailed(error.what());
        _exit(1);
    }

    sim::World world;
    bool started = false;
    std::unique_ptr<Exchange> exchange;
    std::vector<sim::Link> links;
    std::vector<gz::math::Vector3d> centres;
    std::vector<sim::Model> shown;
    std::vector<sim::Entity> touching;
    std::unordered_map<sim::Entity, Part> parts;
};

}
}

GZ_ADD_PLUGIN(skyrange::gazebo::Aircraft, gz::sim::System, skyrange::gazebo::Aircraft::ISystemConfigure,
              skyrange::gazebo::Aircraft::ISystemPreUpdate, skyrange::gazebo::Aircraft::ISystemPostUpdate)
GZ_ADD_PLUGIN_ALIAS(skyrange::gazebo::Aircraft, "skyrange")
