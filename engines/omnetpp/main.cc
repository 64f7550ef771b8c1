// Starts OMNeT++'s environment with the network of the engine, whose NED files lie beside the program.
// SPDX-License-Identifier: MIT
#include <climits>
#include <cstdio>
#include <string>
#include <unistd.h>

extern "C" int evMain(int argc, char* argv[]); // in OMNeT++'s library oppenvir

int
main()
{
    char path[PATH_MAX];
    const ssize_t length = readlink("/proc/self/exe", path, sizeof(path));
    if (length <= 0 || length == ssize_t(sizeof(path)))
    {
        std::perror("/proc/self/exe");
        return 1;
    }
    const std::string program(path, size_t(length));
    const std::string folder = program.substr(0, program.rfind('/'));
    std::string words[] = {program, "-u", "Cmdenv", "-f", folder + "/omnetpp.ini", "-n", folder + ":" SKYRANGE_INET_NED};
    char* argv[std::size(words) + 1] = {};
    for (size_t k = 0; k < std::size(words); k++)
    {
        argv[k] = words[k].data();
    }
    return evMain(int(std::size(words)), argv);
}
