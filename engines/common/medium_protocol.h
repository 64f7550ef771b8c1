// Engine side of skyrange's medium protocol, version 1 (docs/reference/medium-protocol.md): layouts and a connection.
// SPDX-License-Identifier: MIT
#ifndef SKYRANGE_MEDIUM_PROTOCOL_H
#define SKYRANGE_MEDIUM_PROTOCOL_H

#include <array>
#include <cerrno>
#include <cstdint>
#include <cstring>
#include <map>
#include <stdexcept>
#include <string>
#include <sys/socket.h>
#include <unistd.h>
#include <vector>

namespace medium_protocol
{

constexpr uint32_t kVersion = 1;
constexpr char kMagic[8] = {'S', 'K', 'Y', 'M', 'E', 'D', 'I', 'A'};
constexpr uint32_t kMaxBodyBytes = 1U << 28;
constexpr uint32_t kNoRadio = 0xffffffffU;

enum Type : uint16_t
{
    HELLO = 1,
    ADVANCE = 2,
    FORK = 3,
    CLOSE = 4,
    PATH_LOSSES = 5,
    READY = 129,
    DONE = 130,
    FORKED = 131,
    LOSSES = 133,
    FAILED = 255
};

enum Ability : uint32_t
{
    FORKS = 1,
    OWN_LOSSES = 2,
    REPEATS = 4
};

enum Waveform : uint16_t
{
    DSSS_1M = 0,
    OFDM_6M = 1
};

enum Fate : uint16_t
{
    SENT = 0,
    NO_ACCESS = 1,
    REFUSED = 2
};

enum Outcome : uint16_t
{
    DECODED = 0,
    WEAK = 1,
    COLLIDED = 2,
    BUSY = 3,
    SENDING = 4
};

#pragma pack(push, 1)
struct Header
{
    uint32_t length;
    uint16_t type;
    uint16_t zero;
    uint32_t number;
};

struct Transmission
{
    int64_t key;
    int64_t at_ns;
    double power_dbm;
    uint32_t radio;
    uint32_t size_bytes;
    uint16_t waveform;
    uint16_t channel;
    uint32_t first_path;
    uint32_t paths;
    uint32_t zero;
};

struct Noise
{
    int64_t from_ns;
    int64_t to_ns;
    double centre_mhz;
    double width_mhz;
    double power_dbm;
    uint32_t radio;
    uint32_t first_path;
    uint32_t paths;
    uint32_t zero;
};

struct Path
{
    double gain_db;
    uint32_t radio;
    uint32_t zero;
};

struct SentRow
{
    int64_t key;
    int64_t started_ns;
    int64_t ended_ns;
    uint32_t radio;
    uint16_t channel;
    uint16_t fate;
};

struct HeardRow
{
    int64_t key;
    int64_t ended_ns;
    double rssi_dbm;
    double snir_db;
    uint32_t radio;
    uint16_t channel;
    uint16_t outcome;
};
#pragma pack(pop)

static_assert(sizeof(Header) == 12 && sizeof(Transmission) == 48 && sizeof(Noise) == 56 && sizeof(Path) == 16);
static_assert(sizeof(SentRow) == 32 && sizeof(HeardRow) == 40);

struct Radio
{
    std::string name;
    uint64_t stream;
    double noise_figure_db;
};

struct Building
{
    double base_m;
    double top_m;
    std::vector<double> corners_m; // east, north, east, north, …
};

struct Hello
{
    uint64_t seed;
    int64_t origin_ns;
    double horizon_m;
    bool own_losses;
    std::vector<Radio> radios;
    std::map<std::string, std::string> params;
    std::vector<Building> buildings;
};

struct Place
{
    double x;
    double y;
    double z;
};

struct Advance
{
    int64_t until_ns;
    bool has_places;
    std::vector<Place> places; // NaN: an absent radio
    std::vector<Transmission> transmissions;
    std::vector<Noise> noise;
    std::vector<Path> paths;
};

struct Ready
{
    std::string name;
    std::string release;
    uint32_t waveforms;
    uint32_t abilities;
    int64_t lookahead_ns;
};

/// A reason why the engine cannot go on; skyrange is told of it in the last message.
class Failure : public std::runtime_error
{
    using std::runtime_error::runtime_error;
};

/// The other side closed the socket, or asked the engine to end.
class EndOfStream : public std::exception
{
};

/// Checked reading of the body of a message.
class Reader
{
  public:
    explicit Reader(const std::vector<char>& body)
        : m_body(body)
    {
    }

    template <typename T>
    T Value()
    {
        T value;
        std::memcpy(&value, Take(sizeof(T)), sizeof(T));
        return value;
    }

    template <typename T>
    std::vector<T> Rows(uint64_t count)
    {
        if (count > kMaxBodyBytes / sizeof(T))
        {
            throw Failure("a count that is too large for a message");
        }
        const char* data = Take(count * sizeof(T));
        std::vector<T> rows(count);
        if (count > 0)
        {
            std::memcpy(rows.data(), data, count * sizeof(T));
        }
        return rows;
    }

    std::string Text()
    {
        const auto length = Value<uint32_t>();
        return std::string(Take(length), length);
    }

    void End() const
    {
        if (m_at != m_body.size())
        {
            throw Failure("a message that is longer than its fields");
        }
    }

  private:
    const char* Take(uint64_t count)
    {
        if (count > m_body.size() - m_at)
        {
            throw Failure("a message that ends within a field");
        }
        const char* data = m_body.data() + m_at;
        m_at += count;
        return data;
    }

    const std::vector<char>& m_body;
    uint64_t m_at = 0;
};

inline std::map<std::string, std::string>
ParseParams(const std::string& text)
{
    std::map<std::string, std::string> params;
    for (size_t begin = 0; begin < text.size();)
    {
        size_t end = text.find('\n', begin);
        end = end == std::string::npos ? text.size() : end;
        const std::string line = text.substr(begin, end - begin);
        const size_t equals = line.find('=');
        if (equals != std::string::npos)
        {
            params[line.substr(0, equals)] = line.substr(equals + 1);
        }
        begin = end + 1;
    }
    return params;
}

inline Hello
DecodeHello(const std::vector<char>& body)
{
    Reader reader(body);
    Hello hello;
    const auto magic = reader.Value<std::array<char, 8>>();
    const auto version = reader.Value<uint32_t>();
    if (std::memcmp(magic.data(), kMagic, sizeof(kMagic)) != 0 || version != kVersion)
    {
        throw Failure("this engine speaks version " + std::to_string(kVersion) +
                      " of the medium protocol, not version " + std::to_string(version));
    }
    reader.Value<uint32_t>();
    hello.seed = reader.Value<uint64_t>();
    hello.origin_ns = reader.Value<int64_t>();
    hello.horizon_m = reader.Value<double>();
    hello.own_losses = reader.Value<std::array<char, 8>>()[0] != 0;
    const auto radios = reader.Value<uint32_t>();
    const auto buildings = reader.Value<uint32_t>();
    reader.Value<uint32_t>();
    hello.params = ParseParams(reader.Text());
    for (uint32_t k = 0; k < radios; k++)
    {
        Radio radio;
        radio.stream = reader.Value<uint64_t>();
        radio.noise_figure_db = reader.Value<double>();
        radio.name = reader.Text();
        hello.radios.push_back(radio);
    }
    for (uint32_t k = 0; k < buildings; k++)
    {
        Building building;
        building.base_m = reader.Value<double>();
        building.top_m = reader.Value<double>();
        const uint64_t corners = reader.Value<uint32_t>();
        building.corners_m = reader.Rows<double>(2 * corners);
        hello.buildings.push_back(building);
    }
    reader.End();
    return hello;
}

/// Decode an ADVANCE after `now_ns`; all rows, paths, radios and times of the result exist.
inline Advance
DecodeAdvance(const std::vector<char>& body, uint32_t radios, int64_t now_ns)
{
    Reader reader(body);
    Advance advance;
    advance.until_ns = reader.Value<int64_t>();
    reader.Value<int64_t>();
    advance.has_places = reader.Value<uint32_t>() != 0;
    const auto transmissions = reader.Value<uint32_t>();
    const auto noise = reader.Value<uint32_t>();
    const auto paths = reader.Value<uint32_t>();
    advance.places = reader.Rows<Place>(advance.has_places ? radios : 0);
    advance.transmissions = reader.Rows<Transmission>(transmissions);
    advance.noise = reader.Rows<Noise>(noise);
    advance.paths = reader.Rows<Path>(paths);
    reader.End();
    bool good = advance.until_ns >= now_ns;
    for (const auto& path : advance.paths)
    {
        good = good && path.radio < radios;
    }
    for (const auto& row : advance.transmissions)
    {
        good = good && row.radio < radios && row.at_ns > now_ns && row.at_ns <= advance.until_ns;
        good = good && uint64_t(row.first_path) + row.paths <= paths;
    }
    for (const auto& row : advance.noise)
    {
        good = good && (row.radio < radios || row.radio == kNoRadio) && row.to_ns > row.from_ns;
        good = good && row.from_ns > now_ns && row.from_ns <= advance.until_ns;
        good = good && uint64_t(row.first_path) + row.paths <= paths;
    }
    if (!good)
    {
        throw Failure("an ADVANCE with a row, a path or a time that cannot be");
    }
    return advance;
}

/// The socket to skyrange: file descriptor 0 at first, another one in a copy.
class Connection
{
  public:
    explicit Connection(int descriptor = 0)
        : m_socket(descriptor)
    {
    }

    /// Wait for the next request. Throws `EndOfStream` at the end of file and at CLOSE.
    Type Receive(std::vector<char>& body)
    {
        Header header;
        ReadAll(&header, sizeof(header));
        if (header.length > kMaxBodyBytes || header.zero != 0)
        {
            throw Failure("a header that is none of the medium protocol");
        }
        m_number = header.number;
        body.resize(header.length);
        ReadAll(body.data(), body.size());
        if (header.type == CLOSE)
        {
            throw EndOfStream();
        }
        return Type(header.type);
    }

    void Answer(Type type, const std::vector<char>& body)
    {
        const Header header{uint32_t(body.size()), type, 0, m_number};
        std::vector<char> message;
        message.reserve(sizeof(header) + body.size());
        Append(message, &header, sizeof(header));
        Append(message, body.data(), body.size());
        for (size_t done = 0; done < message.size();)
        {
            const ssize_t count = send(m_socket, message.data() + done, message.size() - done, MSG_NOSIGNAL);
            if (count < 0 && errno == EINTR)
            {
                continue;
            }
            if (count <= 0)
            {
                throw EndOfStream();
            }
            done += count;
        }
    }

    void AnswerReady(const Ready& ready)
    {
        std::vector<char> body;
        Append(body, kMagic, sizeof(kMagic));
        const uint32_t head[4] = {kVersion, ready.waveforms, ready.abilities, 0};
        Append(body, head, sizeof(head));
        Append(body, &ready.lookahead_ns, sizeof(ready.lookahead_ns));
        AppendText(body, ready.name);
        AppendText(body, ready.release);
        Answer(READY, body);
    }

    void AnswerDone(uint64_t events,
                    uint32_t active,
                    const std::vector<SentRow>& sent,
                    const std::vector<HeardRow>& heard)
    {
        std::vector<char> body;
        const uint32_t counts[4] = {active, uint32_t(sent.size()), uint32_t(heard.size()), 0};
        Append(body, &events, sizeof(events));
        Append(body, counts, sizeof(counts));
        Append(body, sent.data(), sent.size() * sizeof(SentRow));
        Append(body, heard.data(), heard.size() * sizeof(HeardRow));
        Answer(DONE, body);
    }

    void AnswerLosses(const std::vector<double>& losses_db)
    {
        std::vector<char> body;
        const uint32_t counts[2] = {uint32_t(losses_db.size()), 0};
        Append(body, counts, sizeof(counts));
        Append(body, losses_db.data(), losses_db.size() * sizeof(double));
        Answer(LOSSES, body);
    }

    void AnswerFailed(const std::string& reason)
    {
        std::vector<char> body;
        AppendText(body, reason);
        Answer(FAILED, body);
    }

    /// Fork. The original answers with the copy's process id and goes on; the copy goes on with the socket that came
    /// with the request.
    void Fork()
    {
        if (m_received < 0)
        {
            throw Failure("a FORK without a file descriptor");
        }
        const pid_t pid = fork();
        if (pid < 0)
        {
            throw Failure(std::string("fork: ") + std::strerror(errno));
        }
        close(pid == 0 ? m_socket : m_received);
        if (pid == 0)
        {
            m_socket = m_received;
        }
        m_received = -1;
        const uint32_t copy = pid == 0 ? uint32_t(getpid()) : uint32_t(pid);
        std::vector<char> body;
        Append(body, &copy, sizeof(copy));
        Answer(FORKED, body);
    }

  private:
    static void Append(std::vector<char>& body, const void* data, size_t size)
    {
        const char* bytes = static_cast<const char*>(data);
        body.insert(body.end(), bytes, bytes + size);
    }

    static void AppendText(std::vector<char>& body, const std::string& text)
    {
        const auto length = uint32_t(text.size());
        Append(body, &length, sizeof(length));
        Append(body, text.data(), text.size());
    }

    /// Read so many bytes; a file descriptor that comes along is kept for `Fork`.
    void ReadAll(void* into, size_t size)
    {
        char* data = static_cast<char*>(into);
        while (size > 0)
        {
            alignas(cmsghdr) char control[CMSG_SPACE(sizeof(int))];
            iovec piece{data, size};
            msghdr message{};
            message.msg_iov = &piece;
            message.msg_iovlen = 1;
            message.msg_control = control;
            message.msg_controllen = sizeof(control);
            const ssize_t count = recvmsg(m_socket, &message, MSG_CMSG_CLOEXEC);
            if (count < 0 && errno == EINTR)
            {
                continue;
            }
            if (count <= 0)
            {
                throw EndOfStream();
            }
            for (cmsghdr* each = CMSG_FIRSTHDR(&message); each != nullptr; each = CMSG_NXTHDR(&message, each))
            {
                if (each->cmsg_level == SOL_SOCKET && each->cmsg_type == SCM_RIGHTS)
                {
                    if (m_received >= 0)
                    {
                        close(m_received);
                    }
                    std::memcpy(&m_received, CMSG_DATA(each), sizeof(int));
                }
            }
            data += count;
            size -= count;
        }
    }

    int m_socket;
    int m_received = -1;
    uint32_t m_number = 0;
};

} // namespace medium_protocol

#endif
