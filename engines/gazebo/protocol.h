// The plugin's side of skyrange's protocol with Gazebo, version 1 (src/skyrange/codec/gazebo_protocol.py).
// SPDX-License-Identifier: MIT
#ifndef SKYRANGE_GAZEBO_PROTOCOL_H
#define SKYRANGE_GAZEBO_PROTOCOL_H

#include <algorithm>
#include <cerrno>
#include <cstdint>
#include <cstring>
#include <stdexcept>
#include <string>
#include <sys/socket.h>
#include <unistd.h>
#include <vector>

namespace skyrange
{

constexpr uint32_t kVersion = 1;
constexpr char kMagic[8] = {'S', 'K', 'Y', 'G', 'A', 'Z', 'E', 'B'};
constexpr uint32_t kMaxBodyBytes = 1U << 26;
constexpr uint32_t kMaxTextBytes = 4096;
constexpr uint32_t kMaxMotors = 64;
constexpr uint32_t kMaxSteps = 1000;

enum Type : uint16_t
{
    HELLO = 1,
    STEP = 2,
    READY = 129,
    STEPPED = 130,
    FAILED = 255
};

struct Header
{
    uint32_t length;
    uint16_t type;
    uint16_t zero;
    uint32_t number;
};

// Three numbers in the local frame or in the body.
struct Vector
{
    double x = 0.0, y = 0.0, z = 0.0;
};

struct Rotor
{
    double forward, left, spin;
};

struct Aircraft
{
    std::string model;
    double thrust, torqueArm, rotorDrag, bodyDrag, spinDrag;
    std::vector<Rotor> rotors;
};

struct Hello
{
    uint32_t motors = 0, steps = 0;
    double step = 0.0;
    std::vector<Aircraft> aircraft;
    std::vector<std::string> shown;
};

struct Inputs
{
    std::vector<double> rotors;
    Vector air, impulse, angularImpulse;
};

struct Pose
{
    Vector position;
    double w, x, y, z;
};

struct State
{
    Vector position, velocity;
    double w, x, y, z;
    Vector rates;
};

struct Contact
{
    uint32_t vehicle;
    int32_t other, rotor, otherRotor;
    Vector position, normal;
    double depth;
};

static_assert(sizeof(Header) == 12 && sizeof(Pose) == 56 && sizeof(State) == 104 && sizeof(Contact) == 72,
              "the layouts of the protocol have no padding");

// Reads numbers and texts from a body; throws std::runtime_error where it is too short.
class Reader
{
  public:
    explicit Reader(const std::vector<char> &body) : at(body.data()), end(body.data() + body.size()) {}

    template <typename T> T Take()
    {
        T value;
        Take(&value, sizeof value);
        return value;
    }

    std::string Text()
    {
        const auto length = Take<uint32_t>();
        if (length > kMaxTextBytes)
            throw std::runtime_error("a text is too long");
        std::string text(length, '\0');
        Take(&text[0], length);
        return text;
    }

    void End() const
    {
        if (at != end)
            throw std::runtime_error("a message is too long");
    }

    size_t Left() const { return static_cast<size_t>(end - at); }

  private:
    void Take(void *to, size_t count)
    {
        if (count > Left())
            throw std::runtime_error("a message is too short");
        std::memcpy(to, at, count);
        at += count;
    }

    const char *at;
    const char *end;
};

// Messages over the socket that the process inherited as its standard input.
class Connection
{
  public:
    // Whether standard input is a socket, so that skyrange started this process.
    static bool IsThere()
    {
        int type = 0;
        socklen_t length = sizeof type;
        return getsockopt(STDIN_FILENO, SOL_SOCKET, SO_TYPE, &type, &length) == 0 && type == SOCK_STREAM;
    }

    Hello ReceiveHello()
    {
        const auto body = Receive(HELLO);
        Reader in(body);
        char magic[8];
        for (char &letter : magic)
            letter = in.Take<char>();
        const auto version = in.Take<uint32_t>();
        if (std::memcmp(magic, kMagic, sizeof magic) != 0 || version != kVersion)
            throw std::runtime_error("skyrange speaks version " + std::to_string(version) +
                                     " of the protocol, and the plugin version " + std::to_string(kVersion));
        const auto count = in.Take<uint32_t>();
        const auto shown = in.Take<uint32_t>();
        Hello hello;
        hello.motors = in.Take<uint32_t>();
        hello.steps = in.Take<uint32_t>();
        hello.step = in.Take<double>();
        if (hello.motors == 0 || hello.motors > kMaxMotors || hello.steps == 0 || hello.steps > kMaxSteps ||
            !(hello.step > 0.0) || count > in.Left() || shown > in.Left())
            throw std::runtime_error("HELLO has a number out of its range");
        for (uint32_t i = 0; i < count; ++i)
        {
            Aircraft one;
            one.model = in.Text();
            one.thrust = in.Take<double>();
            one.torqueArm = in.Take<double>();
            one.rotorDrag = in.Take<double>();
            one.bodyDrag = in.Take<double>();
            one.spinDrag = in.Take<double>();
            for (uint32_t m = 0; m < hello.motors; ++m)
                one.rotors.push_back(in.Take<Rotor>());
            hello.aircraft.push_back(one);
        }
        for (uint32_t i = 0; i < shown; ++i)
            hello.shown.push_back(in.Text());
        in.End();
        return hello;
    }

    void SendReady(const std::string &release, const std::string &physics)
    {
        std::string body(kMagic, sizeof kMagic);
        Append(body, kVersion);
        AppendText(body, release);
        AppendText(body, physics);
        Send(READY, body);
    }

    // The tick's time; fills the inputs of all aircraft and the poses of what is shown.
    int64_t ReceiveStep(std::vector<Inputs> &inputs, std::vector<Pose> &shown)
    {
        const auto body = Receive(STEP);
        Reader in(body);
        const auto tick = in.Take<int64_t>();
        for (auto &one : inputs)
        {
            for (double &speed : one.rotors)
                speed = in.Take<double>();
            one.air = in.Take<Vector>();
            one.impulse = in.Take<Vector>();
            one.angularImpulse = in.Take<Vector>();
        }
        for (auto &pose : shown)
            pose = in.Take<Pose>();
        in.End();
        return tick;
    }

    void SendStepped(int64_t tick, const std::vector<State> &states, const std::vector<Contact> &contacts)
    {
        std::string body;
        Append(body, tick);
        Append(body, static_cast<uint32_t>(contacts.size()));
        Append(body, uint32_t{0});
        body.append(reinterpret_cast<const char *>(states.data()), states.size() * sizeof(State));
        body.append(reinterpret_cast<const char *>(contacts.data()), contacts.size() * sizeof(Contact));
        Send(STEPPED, body);
    }

    void SendFailed(const std::string &why)
    {
        std::string body;
        AppendText(body, why);
        Send(FAILED, body);
    }

  private:
    template <typename T> static void Append(std::string &to, T value)
    {
        to.append(reinterpret_cast<const char *>(&value), sizeof value);
    }

    static void AppendText(std::string &to, const std::string &text)
    {
        const auto length = static_cast<uint32_t>(std::min<size_t>(text.size(), kMaxTextBytes));
        Append(to, length);
        to.append(text, 0, length);
    }

    std::vector<char> Receive(Type expected)
    {
        Header header;
        Read(&header, sizeof header);
        if (header.length > kMaxBodyBytes || header.type != expected || header.zero != 0)
            throw std::runtime_error("an unexpected message of type " + std::to_string(header.type));
        number = header.number;
        std::vector<char> body(header.length);
        Read(body.data(), body.size());
        return body;
    }

    // Ends the process where skyrange has closed the socket or has ended: Gazebo serves nobody else.
    static void Read(void *to, size_t count)
    {
        auto *at = static_cast<char *>(to);
        while (count > 0)
        {
            const ssize_t got = recv(STDIN_FILENO, at, count, 0);
            if (got < 0 && errno == EINTR)
                continue;
            if (got <= 0)
                _exit(0);
            at += got;
            count -= static_cast<size_t>(got);
        }
    }

    void Send(Type type, const std::string &body)
    {
        const Header header{static_cast<uint32_t>(body.size()), type, 0, number};
        std::string data(reinterpret_cast<const char *>(&header), sizeof header);
        data += body;
        const char *at = data.data();
        size_t count = data.size();
        while (count > 0)
        {
            const ssize_t sent = send(STDIN_FILENO, at, count, MSG_NOSIGNAL);
            if (sent < 0 && errno == EINTR)
                continue;
            if (sent <= 0)
                _exit(0);
            at += sent;
            count -= static_cast<size_t>(sent);
        }
    }

    uint32_t number = 0;
};

}

#endif
