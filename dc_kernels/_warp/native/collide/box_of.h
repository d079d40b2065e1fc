// Box of a shape whose radius is given. Parameters: model, state. Macros: DISC, SEGMENT.
const int *const body_of = model.shape_body.data, *const kind_of = model.shape_type.data;
const Real* const radius_of = model.shape_radius.data;
const auto* const centers = model.shape_center.data;
const auto* const positions = state.position.data;
const auto* const vertices = model.vertices.data;
const int* const vertex_start = model.vertex_start.data;
const Real* const angles = state.angle.data;
// The body that cosine and sine are of: shapes of one body follow each other.
struct Turned {
    int body = -1;
    Real cosine = 1, sine = 0;
};
// It holds copies, as threads may share the shapes.
auto box_of = [=](int shape, Real radius, Turned& turned) -> Quad {
    const int body = body_of[shape], kind = kind_of[shape];
    const Real *const x = (const Real*)(positions + body), *const center = (const Real*)(centers + shape);
    const bool disc = kind == DISC;
    if (disc && center[0] == 0 && center[1] == 0)
        return quad(x[0], x[1], x[0], x[1]) + quad(-radius, -radius, radius, radius);
    if (body != turned.body) turned = {body, wp::cos(angles[body]), wp::sin(angles[body])};
    const Real cosine = turned.cosine, sine = turned.sine;
    const int begin = vertex_start[shape];
    const int points = disc ? 1 : kind == SEGMENT ? 2 : vertex_start[shape + 1] - begin;
    const Real* p = disc ? center : (const Real*)(vertices + begin);
    Quad box = quad(0, 0, 0, 0);
    for (int i = 0; i < points; ++i, p += 2) {
        const Real px = cosine * p[0] - sine * p[1], py = sine * p[0] + cosine * p[1];
        const Quad point = quad(px, py, -px, -py);
        box = i == 0 ? point : least(box, point);
    }
    return quad(x[0] + box.x - radius, x[1] + box.y - radius, x[0] - box.z + radius, x[1] - box.w + radius);
};
