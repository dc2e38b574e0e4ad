/* What the server answers. route_answer takes a request and the services and fills a response: it
 * does not block, does not know libmicrohttpd, and cannot fail, since a failure is an answer too.
 * What is not in memory becomes out->work: the caller runs it as a job and comes back with
 * route_finish.
 *
 * Conditions are decided before bodies are touched: the entity tag of a tile comes from the index
 * (hash of the stored payload) and the format, so 304 costs no read and no encoding. RFC 9110, RFC
 * 9111, RFC 9457.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/server.h"

#include <stdio.h>
#include <string.h>

static const char IMMUTABLE[] = "public, max-age=31536000, immutable";
static const char MOVING[] = "public, max-age=60, stale-while-revalidate=600, stale-if-error=86400";
static const char SHORT[] = "public, max-age=60";
static const char NO_STORE[] = "no-store";
static const char JSON_TYPE[] = "application/json";

static const struct {
    unsigned allow;
    const char *path;
} routes[] = {
#define ROUTE_ROW(id, allow, path, summary) {allow, path},
    ROUTE_LIST(ROUTE_ROW)
#undef ROUTE_ROW
};

const char *route_path(enum route r)
{
    return routes[r].path;
}

unsigned route_allow(enum route r)
{
    return routes[r].allow;
}

const char *route_status_text(int status)
{
    static const struct {
        int status;
        const char *text;
    } texts[] = {
        {200, "OK"},
        {204, "No Content"},
        {206, "Partial Content"},
        {304, "Not Modified"},
        {307, "Temporary Redirect"},
        {400, "Bad Request"},
        {403, "Forbidden"},
        {404, "Not Found"},
        {405, "Method Not Allowed"},
        {413, "Content Too Large"},
        {414, "URI Too Long"},
        {416, "Range Not Satisfiable"},
        {422, "Unprocessable Content"},
        {500, "Internal Server Error"},
        {501, "Not Implemented"},
        {503, "Service Unavailable"},
        {504, "Gateway Timeout"},
    };
    for (size_t i = 0; i < sizeof(texts) / sizeof(*texts); i++)
        if (texts[i].status == status)
            return texts[i].text;
    return "Error";
}

void route_free(struct response *r)
{
    body_drop(&r->body);
    mem_free(r->location);
    r->location = NULL;
    if (r->work)
        encode_drop(NULL, r->work);
    r->work = NULL;
}

/* ---- putting bytes into a response ---- */

/* members: JSON that goes before the end, beginning with a comma. */
static void send_problem(struct response *out, int status, const char *detail, const char *members)
{
    struct buf b = {0};
    route_free(out);
    buf_printf(&b, "{\"type\":\"about:blank\",\"title\":\"%s\",\"status\":%d,\"detail\":\"",
               route_status_text(status), status);
    for (const char *p = detail; *p; p++)
        if ((unsigned char)*p >= 0x20)
            buf_printf(&b, *p == '"' || *p == '\\' ? "\\%c" : "%c", *p);
    buf_printf(&b, "\"%s}\n", members);
    out->status = status;
    out->type = "application/problem+json";
    out->cache_control = status == 404 ? SHORT : NO_STORE;
    out->vary = out->encoding = NULL;
    out->etag[0] = out->surrogate[0] = 0;
    out->accept_ranges = false;
    out->retry_after_s = 0;
    out->body = body_take(&b, NULL);
    out->data = out->body ? out->body->data : NULL;
    out->size = out->body ? out->body->size : 0;
}

void route_problem(struct response *out, int status, const char *detail)
{
    send_problem(out, status, detail, "");
}

/* A tile that cannot be made. The client learns which and what to do; where the file is and what
 * its hashes are is in the log. */
static void send_tile_problem(struct response *out, bool damaged)
{
    char members[160], text[400];
    const struct key k = out->tile;
    snprintf(members, sizeof(members), ",\"dataset\":\"%s\",\"tile\":{\"z\":%u,\"x\":%u,\"y\":%u}",
             out->tile_of, k.z, k.x, k.y);
    snprintf(
        text, sizeof(text),
        damaged ? "tile %u/%u/%u of dataset %s is damaged: its bytes do not have the hash that the "
                  "index says, so none of them are sent; all other tiles are served. Whoever runs "
                  "this server finds the file in its log, checks it with citysplat verify, and "
                  "restores it or tiles the scene again"
                : "tile %u/%u/%u of dataset %s could not be made; the server's log says why",
        k.z, k.x, k.y, out->tile_of);
    send_problem(out, 500, text, members);
}

/* "tag" -> "tag-gz": another coding of a resource is another representation. */
static void etag_gzip(char *etag)
{
    size_t n = strlen(etag);
    if (n >= 2 && n + 3 < BODY_ETAG_SIZE)
        memcpy(etag + n - 1, "-gz\"", 5);
}

static bool wants_range(const struct request *r, const struct response *out)
{
    return r->method == METHOD_GET && r->range && out->accept_ranges &&
           (!r->if_range || !strcmp(r->if_range, out->etag));
}

/* 200, 206, 304 or 416 with `b`, whose reference is taken. type and cache_control are set already.
 */
static void send_body(const struct request *r, struct body *b, struct response *out)
{
    if (!b) {
        route_problem(out, 503, "out of memory");
        out->retry_after_s = 5;
        return;
    }
    body_drop(&out->body);
    out->body = b;
    out->status = 200;
    out->data = b->data;
    out->size = b->size;
    memcpy(out->etag, b->etag, BODY_ETAG_SIZE);
    out->accept_ranges = !b->gzip;
    if (b->gzip) {
        out->vary = out->vary ? "Accept, Accept-Encoding" : "Accept-Encoding";
        if (condition_gzip(r->accept_encoding)) {
            out->encoding = "gzip";
            out->data = b->gzip;
            out->size = b->gzip_size;
            etag_gzip(out->etag);
        }
    }
    if (condition_none_match(r->if_none_match, out->etag)) {
        out->status = 304;
        return;
    }
    uint64_t first, length;
    if (!wants_range(r, out))
        return;
    out->range_total = out->size;
    switch (condition_range(r->range, out->size, &first, &length)) {
    case RANGE_ALL:
        break;
    case RANGE_PART:
        out->status = 206;
        out->range_first = first;
        out->data += first;
        out->size = (size_t)length;
        break;
    case RANGE_BAD:
        route_problem(out, 416, "the range lies outside the resource");
        out->accept_ranges = true;
        break;
    }
}

static void send_document(const struct request *r, const char *type, const char *cache_control,
                          struct body *b, struct response *out)
{
    out->type = type;
    out->cache_control = cache_control;
    send_body(r, b, out);
}

/* A document made for this request, whose reference is taken; NULL where memory failed: 503. */
static void send_fresh(const struct request *r, const char *type, struct body *b,
                       struct response *out)
{
    send_document(r, type, NO_STORE, b, out);
}

/* The result of work with a known name: 304 and hits are answered now, else *out asks for a job,
 * and the caller says which. True when the caller must. */
static bool send_made(struct services *s, const struct request *r, struct hash128 id,
                      struct response *out)
{
    body_etag(id, out->etag);
    out->accept_ranges = true;
    out->status = 200;
    struct body *b = cache_get(s->cache, id);
    out->cache = b ? "hit" : "miss";
    if (b) {
        send_body(r, b, out);
        return false;
    }
    if (condition_none_match(r->if_none_match, out->etag)) {
        out->status = 304;
        return false;
    }
    return true;
}

static struct work *make_work(struct dataset *d, enum work_kind kind, struct hash128 id,
                              struct form form, struct response *out)
{
    struct work *w = mem_array(1, sizeof(*w));
    if (!w) {
        route_problem(out, 503, "out of memory");
        out->retry_after_s = 5;
        return NULL;
    }
    w->kind = kind;
    w->ds = dataset_ref(d);
    w->id = id;
    w->form = form;
    w->keep = true;
    return out->work = w;
}

static void look_problem(const struct dataset *d, enum err_code rc, const struct err *e,
                         struct response *out)
{
    int status = rc == ERR_NOENT ? 404 : rc == ERR_MEM ? 503 : 400;
    route_problem(out, status,
                  d->appearance ? e->msg
                                : "this dataset was trained without appearance: it has one look, "
                                  "leave `appearance` out");
}

/* The look that a target or a body asks for; false, with the problem set, when there is none such.
 */
static bool find_look(const struct dataset *d, const char *text, struct look *look,
                      struct response *out)
{
    struct err e = {0};
    enum err_code rc = look_find(d, text, look, &e);
    if (rc != ERR_OK)
        look_problem(d, rc, &e, out);
    return rc == ERR_OK;
}

/* ---- the routes ---- */

static void answer_tile(struct services *s, const struct request *r, struct dataset *d,
                        const struct target *t, struct response *out)
{
    const struct store_tile *tile = store_find(d->index, t->key);
    if (!tile) {
        route_problem(out, 404, "no Gaussians in this tile");
        return;
    }
    const struct form form = encode_form(s->cfg, &d->meta, &t->form);
    struct look look;
    if (!find_look(d, t->appearance, &look, out))
        return;
    struct hash128 id = encode_tile_id(d, tile, form, &look);
    out->type = target_type(form.format);
    out->cache_control = IMMUTABLE;
    snprintf(out->surrogate, sizeof(out->surrogate), "ds-%s rev-%s z-%u", d->meta.name,
             d->meta.revision, t->key.z);
    if (!send_made(s, r, id, out))
        return;
    struct work *w = make_work(d, WORK_TILE, id, form, out);
    if (w) {
        w->key = t->key;
        w->look = look;
    }
    out->tile = t->key;
    memcpy(out->tile_of, d->meta.name, sizeof(out->tile_of));
    out->cls = r->prefetch ? JOB_PREFETCH : JOB_TILE;
    out->timeout_s = s->cfg->deadline_s;
}

/* Add the query to the name of what is made from it. */
static void name_query(struct hash128 *id, const struct target *t)
{
    struct {
        struct hash128 id, query;
    } name = {.id = *id};
    char query[LOOK_QUERY_MAX];
    look_query(t, query);
    name.query = hash_bytes(query, strlen(query));
    *id = hash_bytes(&name, sizeof(name));
}

static void answer_seed(struct services *s, const struct request *r, struct dataset *d,
                        const struct target *t, struct response *out)
{
    const struct form form = encode_form(s->cfg, &d->meta, &t->form);
    struct {
        struct hash128 salt;
        char rev[16];
        int32_t bbox_e7[4];
        uint32_t z_min, z_max, format, has_bbox, asked, preset;
    } name = {.salt = d->salt,
              .z_min = t->z_min,
              .z_max = t->z_max,
              .format = (uint32_t)form.format,
              .asked = (uint32_t)t->form.preset << 8 | t->form.sh_degree,
              .preset = form.preset,
              .has_bbox = t->has_bbox};
    memcpy(name.rev, d->meta.revision, sizeof(d->meta.revision));
    memcpy(name.bbox_e7, t->bbox_e7, sizeof(name.bbox_e7));
    struct look look;
    if (!find_look(d, t->appearance, &look, out))
        return;
    struct hash128 id = hash_bytes(&name, sizeof(name));
    name_query(&id, t);
    out->type = "application/x-ndjson";
    out->cache_control = MOVING;
    if (!send_made(s, r, id, out))
        return;
    struct work *w = make_work(d, WORK_SEED, id, form, out);
    if (w) {
        w->target = *t;
        w->look = look;
    }
    out->cls = JOB_TILE;
    out->timeout_s = s->cfg->deadline_s;
}

/* The plain one is made when a dataset is opened; one that asks for its tiles with a query is a
 * job. */
static void answer_tileset(struct services *s, const struct request *r, struct dataset *d,
                           const struct target *t, struct response *out)
{
    char query[LOOK_QUERY_MAX];
    struct look look;
    bool moving = t->route == ROUTE_TILESET_MOVING;
    look_query(t, query);
    out->type = JSON_TYPE;
    out->cache_control = moving ? MOVING : IMMUTABLE;
    if (!moving)
        snprintf(out->surrogate, sizeof(out->surrogate), "ds-%s rev-%s", d->meta.name,
                 d->meta.revision);
    if (!query[0]) {
        send_body(r, body_ref(moving ? d->tileset_moving : d->tileset), out);
        return;
    }
    struct {
        struct hash128 salt;
        char rev[16], kind[16];
    } name = {.salt = d->salt};
    memcpy(name.rev, d->meta.revision, sizeof(d->meta.revision));
    memcpy(name.kind, moving ? "tileset moving" : "tileset", moving ? 15 : 8);
    struct hash128 id = hash_bytes(&name, sizeof(name));
    name_query(&id, t);
    if (!find_look(d, t->appearance, &look, out) || !send_made(s, r, id, out))
        return;
    struct work *w = make_work(d, WORK_TILESET, id, (struct form){0}, out);
    if (w)
        w->target = *t;
    out->cls = JOB_TILE;
    out->timeout_s = s->cfg->deadline_s;
}

static void send_look(const struct request *r, struct dataset *d, const char *text,
                      const char *cache_control, struct response *out)
{
    struct err e = {0};
    struct body *b = NULL;
    enum err_code rc = look_describe(d, text, &b, &e);
    if (rc == ERR_OK)
        send_document(r, JSON_TYPE, cache_control, b, out);
    else
        look_problem(d, rc, &e, out);
}

static void answer_mix(const struct request *r, struct dataset *d, struct response *out)
{
    struct err e = {0};
    char text[LOOK_TEXT_MAX];
    enum err_code rc = look_read_mix(d, r->body, r->body_size, text, &e);
    if (rc == ERR_OK)
        send_look(r, d, text, NO_STORE, out);
    else
        route_problem(out,
                      rc == ERR_MEM     ? 503
                      : rc == ERR_NOENT ? 404
                      : rc == ERR_DATA  ? 422
                                        : 400,
                      e.msg);
}

/* False, with the problem set, when pictures cannot be made or this one is too large. */
static bool check_view(struct services *s, uint32_t width_px, uint32_t height_px,
                       struct response *out)
{
    char text[256], why[160] = "this server was started with --device none";
    if (!s->picture || picture_state(s->picture) == PICTURE_OFF) {
        if (s->picture)
            picture_about(s->picture, why, sizeof(why));
        snprintf(text, sizeof(text), "pictures are off: %s; tiles are served", why);
        route_problem(out, 503, text);
        out->retry_after_s = 10;
        return false;
    }
    uint64_t side = (uint64_t)s->cfg->max_view_px;
    if (!width_px || !height_px || width_px > side || height_px > side ||
        (double)width_px * height_px > s->cfg->max_view_mpx * 1e6) {
        snprintf(text, sizeof(text),
                 "a picture has 1 to %u pixels a side and at most %g megapixels", (unsigned)side,
                 s->cfg->max_view_mpx);
        route_problem(out, 422, text);
        return false;
    }
    return true;
}

/* What decides a picture's bytes. The device counts: other hardware rounds otherwise. */
static struct hash128 view_id(struct services *s, const struct dataset *d, const struct camera *cam,
                              const struct look *look, enum format format, int quality)
{
    struct {
        struct hash128 salt;
        char rev[16], device[160];
        double rot[9], trans[3], focal[4];
        uint32_t width, height, format, quality;
    } name;
    memset(&name, 0, sizeof(name));
    name.salt = d->salt;
    memcpy(name.rev, d->meta.revision, sizeof(d->meta.revision));
    picture_about(s->picture, name.device, sizeof(name.device));
    memcpy(name.rot, cam->rot, sizeof(name.rot));
    memcpy(name.trans, cam->trans, sizeof(name.trans));
    name.focal[0] = cam->fx_px;
    name.focal[1] = cam->fy_px;
    name.focal[2] = cam->cx_px;
    name.focal[3] = cam->cy_px;
    name.width = cam->width_px;
    name.height = cam->height_px;
    name.format = (uint32_t)format;
    name.quality = (uint32_t)quality;
    struct hash128 id = hash_bytes(&name, sizeof(name));
    look_mix(&id, look);
    return id;
}

static void answer_view(struct services *s, const struct request *r, struct dataset *d,
                        const struct target *t, struct response *out)
{
    struct err e = {0};
    struct camera cam;
    const struct view_pose pose = {
        .lon_deg = t->pose.lon_e7 / 1e7,
        .lat_deg = t->pose.lat_e7 / 1e7,
        .h_m = t->pose.h_mm / 1e3,
        .heading_deg = t->pose.heading_e3 / 1e3,
        .pitch_deg = t->pose.pitch_e3 / 1e3,
        .fov_y_deg = t->pose.fov_e3 / 1e3,
    };
    struct look look;
    if (!check_view(s, t->width_px, t->height_px, out) || !find_look(d, t->appearance, &look, out))
        return;
    if (view_camera(&d->meta.origin, &pose, t->width_px, t->height_px, &cam, &e) != ERR_OK) {
        route_problem(out, 422, e.msg);
        return;
    }
    int quality = (int)s->cfg->quality;
    struct hash128 id = view_id(s, d, &cam, &look, t->form.format, quality);
    out->type = target_type(t->form.format);
    out->cache_control = IMMUTABLE;
    snprintf(out->surrogate, sizeof(out->surrogate), "ds-%s rev-%s view", d->meta.name,
             d->meta.revision);
    if (!send_made(s, r, id, out))
        return;
    struct work *w = make_work(d, WORK_VIEW, id, (struct form){.format = t->form.format}, out);
    if (w) {
        w->cam = cam;
        w->look = look;
        w->quality = quality;
    }
    out->cls = JOB_VIEW;
    out->timeout_s = s->cfg->deadline_s;
}

static void answer_render(struct services *s, const struct request *r, struct dataset *d,
                          struct response *out)
{
    struct err e = {0};
    struct describe_render p;
    struct look look;
    enum err_code rc = describe_read_render(s->cfg, &d->meta.origin, r->body, r->body_size, &p, &e);
    if (rc != ERR_OK) {
        route_problem(out, rc == ERR_MEM ? 503 : rc == ERR_DATA ? 422 : 400, e.msg);
        return;
    }
    if (!check_view(s, p.cam.width_px, p.cam.height_px, out) ||
        !find_look(d, p.appearance, &look, out))
        return;
    out->type = target_type(p.format);
    out->cache_control = NO_STORE;
    out->cache = "none";
    out->status = 200;
    struct work *w = make_work(d, WORK_VIEW, view_id(s, d, &p.cam, &look, p.format, p.quality),
                               (struct form){.format = p.format}, out);
    if (w) {
        w->cam = p.cam;
        w->look = look;
        w->quality = p.quality;
        w->keep = false;
    }
    out->cls = JOB_VIEW;
    out->timeout_s = p.timeout_s;
}

/* 307 to the same thing in the current revision, relative, so that it works below any prefix. */
static void answer_moving(const struct request *r, const struct dataset *d, const struct target *t,
                          struct response *out)
{
    const char *word = t->route == ROUTE_TILE_MOVING ? "/t/" : "/static/";
    const char *up = t->route == ROUTE_TILE_MOVING ? "../../../" : "../../";
    struct buf b = {0};
    size_t at = strlen("/d/") + strlen(t->ds) + strlen(word);
    buf_printf(&b, "%sr/%s%s%.*s", up, d->meta.revision, word, (int)(r->target_size - at),
               r->target + at); /* with its query */
    if (b.failed || !(out->location = mem_text((const char *)b.data)))
        route_problem(out, 503, "out of memory");
    else
        out->status = 307;
    out->cache_control = out->status == 307 ? MOVING : NO_STORE;
    buf_free(&b);
}

static void answer_landing(struct services *s, const struct request *r, struct response *out)
{
    const struct static_file *index = static_find(&s->web, "/index.html", strlen("/index.html"));
    out->vary = "Accept";
    if (index && condition_html(r->accept))
        send_document(r, index->type, MOVING, body_ref(index->body), out);
    else
        send_document(r, JSON_TYPE, MOVING, body_ref(s->landing), out);
}

static void answer_ready(struct services *s, const struct request *r, struct response *out)
{
    if (atomic_load(&s->draining))
        route_problem(out, 503, "the server is stopping");
    else
        send_document(r, JSON_TYPE, NO_STORE, body_text("{\"status\":\"ready\"}\n"), out);
}

static void answer_metrics(struct services *s, const struct request *r, struct response *out)
{
    struct buf b = {0};
    if (!r->local) {
        route_problem(out, 403, "metrics are for clients on this machine");
        return;
    }
    struct body *text = metrics_text(s, &b, NULL) ? NULL : body_take(&b, NULL);
    buf_free(&b);
    send_fresh(r, "text/plain; version=0.0.4; charset=utf-8", text, out);
}

static void answer_version(struct services *s, const struct request *r, struct response *out)
{
    struct body *b = NULL;
    /* A statement of its own: the order in which arguments of a call are evaluated is open. */
    if (describe_version(s, &b, NULL))
        body_drop(&b);
    send_fresh(r, JSON_TYPE, b, out);
}

/* Routes below a dataset. */
static void answer_data(struct services *s, const struct request *r, struct dataset *d,
                        const struct target *t, struct response *out)
{
    switch (t->route) {
    case ROUTE_COLLECTION:
        send_document(r, JSON_TYPE, MOVING, body_ref(d->collection), out);
        break;
    case ROUTE_TILEJSON:
        send_document(r, JSON_TYPE, MOVING, body_ref(d->tilejson), out);
        break;
    case ROUTE_TILESET_MOVING:
    case ROUTE_TILESET:
        answer_tileset(s, r, d, t, out);
        break;
    case ROUTE_APPEARANCES:
        send_document(r, JSON_TYPE, MOVING, body_ref(d->appearances), out);
        break;
    case ROUTE_APPEARANCE:
        send_look(r, d, t->appearance, MOVING, out);
        break;
    case ROUTE_MIX:
        answer_mix(r, d, out);
        break;
    case ROUTE_TILE:
        answer_tile(s, r, d, t, out);
        break;
    case ROUTE_VIEW:
        answer_view(s, r, d, t, out);
        break;
    case ROUTE_TILE_MOVING:
    case ROUTE_VIEW_MOVING:
        answer_moving(r, d, t, out);
        break;
    case ROUTE_RENDER:
        answer_render(s, r, d, out);
        break;
    case ROUTE_SEED:
        answer_seed(s, r, d, t, out);
        break;
    default:
        route_problem(out, 404, "there is nothing at this path");
    }
}

/* Routes that need no dataset; false for the others. */
static bool answer_plain(struct services *s, const struct request *r, const struct target *t,
                         struct response *out)
{
    const struct static_file *file;
    struct catalog *c;
    switch (t->route) {
    case ROUTE_LANDING:
        answer_landing(s, r, out);
        return true;
    case ROUTE_STATIC:
        file = static_find(&s->web, r->target, t->path_size);
        send_document(r, file->type, file->immutable ? IMMUTABLE : MOVING, body_ref(file->body),
                      out);
        return true;
    case ROUTE_CONFORMANCE:
        send_document(r, JSON_TYPE, MOVING, body_ref(s->conformance), out);
        return true;
    case ROUTE_API:
        send_document(r, "application/vnd.oai.openapi+json;version=3.0", MOVING, body_ref(s->api),
                      out);
        return true;
    case ROUTE_COLLECTIONS:
        c = services_catalog(s);
        send_document(r, JSON_TYPE, MOVING, body_ref(c->collections), out);
        catalog_drop(&c);
        return true;
    case ROUTE_HEALTH:
        send_document(r, JSON_TYPE, NO_STORE, body_text("{\"status\":\"ok\"}\n"), out);
        return true;
    case ROUTE_READY:
        answer_ready(s, r, out);
        return true;
    case ROUTE_VERSION:
        answer_version(s, r, out);
        return true;
    case ROUTE_METRICS:
        answer_metrics(s, r, out);
        return true;
    default:
        return false;
    }
}

static const char *allow_text(unsigned allow)
{
    return allow == ALLOW_POST ? "POST, OPTIONS" : "GET, HEAD, OPTIONS";
}

/* True when the method is answered here: a preflight, or one the route does not take. */
static bool answer_method(const struct request *r, unsigned allow, struct response *out)
{
    bool read = r->method == METHOD_GET || r->method == METHOD_HEAD;
    if ((read && (allow & ALLOW_READ)) || (r->method == METHOD_POST && (allow & ALLOW_POST)))
        return false;
    if (r->method == METHOD_OPTIONS) {
        out->status = 204;
        out->cache_control = NO_STORE;
    } else {
        route_problem(out, 405, "the method is not one of those in Allow");
    }
    out->allow = allow_text(allow);
    return true;
}

void route_answer(struct services *s, const struct request *r, struct response *out)
{
    struct err e = {0};
    struct target t;
    memset(out, 0, sizeof(*out));
    out->queue_s = out->run_s = -1;
    out->route = ROUTE_NONE;
    enum err_code rc = target_parse(r->target, r->target_size, &t, &e);
    bool found = t.route != ROUTE_STATIC || static_find(&s->web, r->target, t.path_size);
    if (rc == ERR_OK && !found)
        rc = err_set(&e, ERR_NOENT, "there is nothing at this path");
    out->route = found ? t.route : ROUTE_NONE;
    if (rc != ERR_OK) {
        route_problem(out, rc == ERR_NOENT ? 404 : rc == ERR_DATA ? 422 : 400, e.msg);
        return;
    }
    if (answer_method(r, routes[t.route].allow, out) || answer_plain(s, r, &t, out))
        return;
    struct catalog *c = services_catalog(s);
    struct dataset *d = catalog_find(c, t.ds, t.rev);
    if (d)
        answer_data(s, r, d, &t, out);
    else
        route_problem(out, 404,
                      catalog_find(c, t.ds, "") ? "this revision is not served any more"
                                                : "no dataset has this name");
    catalog_drop(&c);
}

void route_finish(struct services *s, const struct request *r, struct job_result *result,
                  struct response *out)
{
    out->queue_s = result->queue_s;
    out->run_s = result->run_s;
    out->cache = result->coalesced ? "shared" : out->cache;
    out->work = NULL; /* the job owned it */
    struct body *b = result->body;
    result->body = NULL;
    if (result->end == JOB_OK) {
        if (out->cache_control ==
            NO_STORE) { /* a posted camera: the name of the bytes is of no use */
            out->body = b;
            out->data = b->data;
            out->size = b->size;
        } else {
            send_body(r, b, out);
        }
        return;
    }
    body_drop(&b);
    enum job_class cls = out->cls;
    bool soon = result->end != JOB_ERROR || result->code == ERR_MEM || result->code == ERR_BUSY;
    if (soon || result->code == ERR_DEVICE) {
        route_problem(out, result->end == JOB_TIMEOUT ? 504 : 503, result->msg);
        out->retry_after_s = job_retry_after(s->jobs, cls);
    } else if (result->code == ERR_NOENT) {
        route_problem(out, 404, result->msg);
    } else {
        /* The message names files and is in the log. */
        if (out->tile_of[0])
            send_tile_problem(out, result->code == ERR_FORMAT);
        else
            route_problem(out, 500,
                          cls == JOB_VIEW ? "the picture could not be made; the log says why"
                                          : "the list could not be made; the log says why");
    }
}
