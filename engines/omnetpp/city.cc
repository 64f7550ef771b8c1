// The buildings as INET's physical environment: prisms of one material.
// SPDX-License-Identifier: MIT
#include "air.h"

#include "inet/common/geometry/shape/Prism.h"
#include "inet/environment/common/MaterialRegistry.h"
#include "inet/environment/common/PhysicalEnvironment.h"

#include <algorithm>
#include <cmath>

using namespace inet;
using namespace inet::physicalenvironment;
using namespace omnetpp;
using namespace medium_protocol;

namespace skyrange
{

namespace
{

using Corners = std::vector<Coord>;

double
Turn(const Coord& a, const Coord& b, const Coord& c)
{
    return (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x);
}

double
DoubleArea(const Corners& corners)
{
    double area = 0.0;
    for (size_t k = 0; k < corners.size(); k++)
    {
        const Coord& next = corners[(k + 1) % corners.size()];
        area += corners[k].x * next.y - next.x * corners[k].y;
    }
    return area;
}

bool
IsConvex(const Corners& corners)
{
    const size_t count = corners.size();
    for (size_t k = 0; k < count; k++)
    {
        if (Turn(corners[k], corners[(k + 1) % count], corners[(k + 2) % count]) < 0.0)
        {
            return false;
        }
    }
    return true;
}

bool
IsEar(const Corners& corners, size_t at)
{
    const size_t count = corners.size();
    const Coord& a = corners[(at + count - 1) % count];
    const Coord& b = corners[at];
    const Coord& c = corners[(at + 1) % count];
    if (Turn(a, b, c) <= 0.0)
    {
        return false;
    }
    for (const Coord& point : corners)
    {
        const bool corner = point == a || point == b || point == c;
        if (!corner && Turn(a, b, point) >= 0.0 && Turn(b, c, point) >= 0.0 && Turn(c, a, point) >= 0.0)
        {
            return false;
        }
    }
    return true;
}

/// Convex parts of a simple polygon that turns left: itself, or triangles (ear clipping, Meisters 1975). INET intersects
/// convex shapes only.
std::vector<Corners>
ConvexParts(Corners corners)
{
    std::vector<Corners> parts;
    while (corners.size() > 3 && !IsConvex(corners))
    {
        size_t at = 0;
        while (at < corners.size() && !IsEar(corners, at))
        {
            at++;
        }
        if (at == corners.size())
        {
            return parts; // crosses itself: what was found stands
        }
        const size_t count = corners.size();
        parts.push_back({corners[(at + count - 1) % count], corners[at], corners[(at + 1) % count]});
        corners.erase(corners.begin() + long(at));
    }
    parts.push_back(corners);
    return parts;
}

Corners
CornersOf(const Building& building)
{
    Corners corners;
    for (size_t k = 0; k + 1 < building.corners_m.size(); k += 2)
    {
        corners.emplace_back(building.corners_m[k], building.corners_m[k + 1], 0.0);
    }
    if (DoubleArea(corners) < 0.0)
    {
        std::reverse(corners.begin(), corners.end());
    }
    return corners;
}

} // namespace

class City : public PhysicalEnvironment
{
  protected:
    void initialize(int stage) override;

  private:
    void Add(const Corners& corners, double base_m, double top_m, const Material* material);
};

Define_Module(City);

void
City::initialize(int stage)
{
    PhysicalEnvironment::initialize(stage);
    if (stage != INITSTAGE_PHYSICAL_ENVIRONMENT)
    {
        return;
    }
    const Air& air = TheAir();
    const Material* material = MaterialRegistry::getInstance().getMaterial(air.settings.material.c_str());
    for (const Building& building : air.hello.buildings)
    {
        const Corners corners = CornersOf(building);
        if (corners.size() < 3 || !(building.top_m > building.base_m) || DoubleArea(corners) == 0.0)
        {
            continue;
        }
        for (const Corners& part : ConvexParts(corners))
        {
            Add(part, building.base_m, building.top_m, material);
        }
    }
}

/// The place of an object is the middle of its bounding box, as INET's object caches assume. (From XML, INET puts the base
/// of a prism there, and its caches then miss the upper half.)
void
City::Add(const Corners& corners, double base_m, double top_m, const Material* material)
{
    Coord low = corners[0];
    Coord high = corners[0];
    for (const Coord& corner : corners)
    {
        low = low.min(corner);
        high = high.max(corner);
    }
    Coord middle = (low + high) / 2;
    middle.z = (top_m - base_m) / 2;
    Corners own;
    for (const Coord& corner : corners)
    {
        own.push_back(corner - middle);
    }
    auto shape = new Prism(top_m - base_m, Polygon(own));
    middle.z = (base_m + top_m) / 2;
    low.z = base_m;
    high.z = top_m;
    spaceMin = objects.empty() ? low : spaceMin.min(low);
    spaceMax = objects.empty() ? high : spaceMax.max(high);
    shapes.push_back(shape);
    objects.push_back(new PhysicalObject("building", int(objects.size()), middle, Quaternion::IDENTITY, shape, material,
                                         1.0, cFigure::BLACK, cFigure::GREY, 1.0, nullptr, nullptr));
}

} // namespace skyrange
