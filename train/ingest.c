/* The whole way from photographs and a COLMAP model to a scene folder.
 *
 * Photographs are judged in three steps: do they see enough points, does their pose agree with the points they
 * see (a wrong pose has a large reprojection error whatever GPS says), does their place agree with their GPS
 * position (georef.c). What fails is dropped, with its observations, and named in the report. The split into
 * training and test photographs goes by rank among all photographs of the model, so that it does not depend on
 * what was dropped. The scene appears when it is complete.
 *
 * Heights: EXIF altitudes are taken as given, plus --geoid-offset-m. The origin lies in the middle of the
 * kept photographs at the height of the median point, so the ground is near z = 0.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "train/ingest.h"

#include <math.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/pool.h"
#include "train/outdir.h"

static const struct options_def defs[] = {
#define OPT(type, key, def, lo, hi, unit, help) OPTIONS_ROW(struct ingest_config, type, key, def, lo, hi, unit, help)
#include "train/ingest.def"
#undef OPT
};

const struct options_spec *ingest_options(void)
{
    static const struct options_spec spec = {
        .command = "ingest",
        .usage = "citysplat ingest PHOTOS SPARSE -o SCENE [options]",
        .about = "Photographs with EXIF GPS and their COLMAP model (a folder with cameras, images and points3D, .bin or "
                 ".txt) become a scene in metres, east-north-up: undistorted pictures, poses, points. Photographs "
                 "whose pose or GPS position cannot be right are dropped and named.",
        .example = "citysplat ingest photos photos/sparse/0 -o scene",
        .defs = defs,
        .n_defs = sizeof defs / sizeof *defs,
        .min_args = 2,
        .max_args = 2,
    };
    return &spec;
}

static const double reliable_px = 2, inlier_m = 8;
enum { RELIABLE_TRACK = 3, HEIGHT_SAMPLES = 200000 };

struct ingest {
    const struct ingest_config *cfg;
    const char *images_dir;
    struct outdir dir;
    struct colmap_model model;
    struct ingest_photo *photos; /* by name; all arrays and names from the scene's arena */
    size_t n;
    struct ingest_view *views;
    size_t n_views;
    uint32_t *kept; /* [model.n_images] index in the scene, UINT32_MAX = dropped; by index in the model */
    struct georef_result georef;
    bool fitted;
    struct scene scene;
    struct progress progress;
    atomic_flag progress_busy; /* whoever holds it may touch `progress` */
    atomic_size_t done;
};

static enum err_code no_memory(struct err *e)
{
    return err_set(e, ERR_MEM, "ingest: out of memory");
}

static void step_done(struct ingest *g)
{
    size_t done = atomic_fetch_add(&g->done, 1) + 1;
    if (!atomic_flag_test_and_set(&g->progress_busy)) {
        progress_step(&g->progress, done, NULL);
        atomic_flag_clear(&g->progress_busy);
    }
}

/* pool_for over the photographs with a progress bar. */
static enum err_code for_photos(struct ingest *g, const char *what,
                                enum err_code (*fn)(void *user, size_t i, struct err *e), struct err *e)
{
    atomic_store(&g->done, 0);
    progress_start(&g->progress, what, g->n);
    enum err_code rc = pool_for(g->n, 0, fn, g, e);
    progress_end(&g->progress, NULL);
    return rc;
}

/* ---- the photographs ------------------------------------------------------------------------------ */

/* A relative path that stays below its folder. */
static bool name_is_safe(const char *s)
{
    if (s[0] == '/')
        return false;
    for (const char *p = s; *p; p += strcspn(p, "/"), p += *p == '/')
        if (!strncmp(p, "..", 2) && (p[2] == '/' || !p[2]))
            return false;
    return true;
}

static int photo_compare(const void *a, const void *b)
{
    const struct ingest_photo *p = a, *q = b;
    return strcmp(p->image->name, q->image->name);
}

static int text_compare(const void *a, const void *b)
{
    char *const *p = a, *const *q = b;
    return strcmp(*p, *q);
}

/* "flight 1/DSC_1.JPG" -> "flight 1_DSC_1.JPG", or "....JPG.png" when the format changes. */
static char *out_name_make(struct ingest *g, const char *name)
{
    static const char *const suffixes[2][2] = {{".jpg", ".jpeg"}, {".png", ".png"}};
    const char *const *want = suffixes[g->cfg->format], *dot = strrchr(name, '.');
    bool fits = false;
    for (int k = 0; k < 2 && dot; k++) {
        char low[8] = "";
        for (size_t i = 0; i + 1 < sizeof low && dot[i]; i++)
            low[i] = (char)(dot[i] >= 'A' && dot[i] <= 'Z' ? dot[i] + 32 : dot[i]);
        fits = fits || !strcmp(low, want[k]);
    }
    char *out = arena_printf(&g->scene.arena, "%s%s", name, fits ? "" : want[0]);
    for (char *p = out; p && *p; p++)
        if (*p == '/')
            *p = '_';
    return out;
}

static enum err_code out_names_check(const struct ingest *g, struct err *e)
{
    char **names = mem_array(g->n, sizeof *names);
    enum err_code rc = names ? ERR_OK : no_memory(e);
    for (size_t i = 0; names && i < g->n; i++)
        names[i] = g->photos[i].out_name;
    if (names)
        qsort(names, g->n, sizeof *names, text_compare);
    for (size_t i = 1; rc == ERR_OK && i < g->n; i++)
        if (!strcmp(names[i], names[i - 1]))
            rc = err_set(e, ERR_DATA, "two photographs would both be called %.200s in the scene; rename one", names[i]);
    mem_free(names);
    return rc;
}

static enum err_code list_photos(struct ingest *g, struct err *e)
{
    g->n = g->model.n_images;
    if (!g->n)
        return err_set(e, ERR_DATA, "the COLMAP model holds no images");
    if (!file_is_dir(g->images_dir))
        return err_set(e, ERR_NOENT, "%s: no such folder of photographs", g->images_dir);
    g->photos = arena_get(&g->scene.arena, g->n, sizeof *g->photos);
    g->kept = arena_get(&g->scene.arena, g->n, sizeof *g->kept);
    if (!g->photos || !g->kept)
        return no_memory(e);
    size_t missing = 0;
    const char *first = NULL;
    for (size_t i = 0; i < g->n; i++)
        g->photos[i].image = &g->model.images[i];
    qsort(g->photos, g->n, sizeof *g->photos, photo_compare);
    for (size_t i = 0; i < g->n; i++) {
        struct ingest_photo *p = &g->photos[i];
        char path[FILE_PATH_MAX];
        p->residual_m = (double)NAN;
        if (!name_is_safe(p->image->name))
            return err_set(e, ERR_DATA, "images: '%.200s' leads out of the folder of photographs", p->image->name);
        p->out_name = out_name_make(g, p->image->name);
        if (!p->out_name)
            return no_memory(e);
        enum err_code rc = file_join(path, g->images_dir, p->image->name, e);
        if (rc != ERR_OK)
            return rc;
        if (!file_exists(path)) {
            p->verdict = INGEST_MISSING;
            first = missing++ ? first : p->image->name;
        }
    }
    if (missing == g->n || (missing && !g->cfg->skip_missing))
        return err_set(e, ERR_NOENT, "%s: %zu of the %zu photographs of the COLMAP model are not in there, '%.200s' first; "
                                     "give the folder that COLMAP was run on%s", g->images_dir, missing, g->n, first,
                       missing == g->n ? "" : ", or drop them with --skip-missing");
    return out_names_check(g, e);
}

/* ---- EXIF and sizes --------------------------------------------------------------------------------- */

static enum err_code read_info_task(void *user, size_t i, struct err *e)
{
    struct ingest *g = user;
    struct ingest_photo *p = &g->photos[i];
    char path[FILE_PATH_MAX];
    if (p->verdict == INGEST_MISSING)
        return ERR_OK;
    if (clock_stopping())
        return err_set(e, ERR_CANCEL, "stopped");
    enum err_code rc = file_join(path, g->images_dir, p->image->name, e);
    if (rc == ERR_OK)
        rc = image_read_info(path, &p->width_px, &p->height_px, &p->gps, e);
    if (rc != ERR_OK)
        return rc;
    const struct lens *l = &g->model.cameras[p->image->camera].lens;
    if (fabs((double)p->width_px * l->height_px / l->width_px - p->height_px) > 1.001)
        return err_set(e, ERR_DATA, "%s: is %u x %u px, its COLMAP camera %u x %u px: not the photographs the model was made "
                                    "from, or turned by a viewer", path, p->width_px, p->height_px, l->width_px, l->height_px);
    step_done(g);
    return ERR_OK;
}

/* "2024:06:01 10:00:00" as seconds; NaN when it is nothing of the kind. */
static double time_seconds(const char *s)
{
    int y, mo, d, h, mi, sec;
    if (sscanf(s, "%4d:%2d:%2d %2d:%2d:%2d", &y, &mo, &d, &h, &mi, &sec) != 6 || y < 1900 || mo < 1 || mo > 12)
        return (double)NAN;
    /* Days of the proleptic Gregorian calendar, March first so that leap days come last. */
    int a = mo < 3, yy = y - a, mm = mo + 12 * a - 3;
    double days = 365.0 * yy + yy / 4 - yy / 100 + yy / 400 + (153 * mm + 2) / 5 + d;
    return days * 86400 + h * 3600 + mi * 60 + sec;
}

struct moment {
    double s;
    size_t photo;
};

static int moment_compare(const void *a, const void *b)
{
    const struct moment *p = a, *q = b;
    if (p->s != q->s)
        return p->s < q->s ? -1 : 1;
    return (p->photo > q->photo) - (p->photo < q->photo);
}

/* Flights: a pause begins another. Without times, every folder is one. */
static enum err_code find_flights(struct ingest *g, struct err *e)
{
    struct moment *m = mem_array(g->n, sizeof *m);
    if (!m)
        return no_memory(e);
    size_t n = 0;
    for (size_t i = 0; i < g->n; i++) {
        double s = time_seconds(g->photos[i].gps.time);
        if (isfinite(s))
            m[n++] = (struct moment){s, i};
    }
    qsort(m, n, sizeof *m, moment_compare);
    uint32_t flight = 0;
    for (size_t k = 0; k < n; k++) {
        flight += k && m[k].s - m[k - 1].s > 60 * g->cfg->flight_gap_min;
        g->photos[m[k].photo].geo.flight_hint = flight;
    }
    for (size_t i = 1; n == 0 && i < g->n; i++) {
        const char *a = g->photos[i - 1].image->name, *b = g->photos[i].image->name;
        size_t folder = (size_t)(strrchr(b, '/') ? strrchr(b, '/') - b : 0);
        flight += strncmp(a, b, folder) || (strrchr(a, '/') ? strrchr(a, '/') - a : 0) != (ptrdiff_t)folder;
        g->photos[i].geo.flight_hint = flight;
    }
    mem_free(m);
    return ERR_OK;
}

/* ---- poses against points ------------------------------------------------------------------------------ */

/* Distance in pixels between an observation and where its point projects; NaN behind the camera. */
static double reprojection_at(const struct ingest *g, const struct ingest_photo *p, const struct colmap_observation *o)
{
    const double *x = g->model.points[o->point].xyz, *r = p->geo.rot;
    const struct lens *l = &g->model.cameras[p->image->camera].lens;
    double t[3], u, v;
    for (int a = 0; a < 3; a++)
        t[a] = r[3 * a] * x[0] + r[3 * a + 1] * x[1] + r[3 * a + 2] * x[2] + p->image->trans[a];
    if (!(t[2] > 0))
        return 1e9;
    lens_distort(l, t[0] / t[2], t[1] / t[2], &u, &v);
    double d = hypot(u - o->x_px, v - o->y_px);
    return d < 1e9 ? d : 1e9;
}

static enum err_code judge_poses(struct ingest *g, struct err *e)
{
    size_t most = 0;
    for (size_t i = 0; i < g->n; i++)
        most = g->photos[i].image->n_obs > most ? g->photos[i].image->n_obs : most;
    double *scratch = mem_array(most, sizeof *scratch);
    if (!scratch)
        return no_memory(e);
    for (size_t i = 0; i < g->n; i++) {
        struct ingest_photo *p = &g->photos[i];
        camera_quat_to_rot(p->image->quat_wxyz, p->geo.rot);
        for (int a = 0; a < 3; a++)
            p->geo.center[a] = -(p->geo.rot[a] * p->image->trans[0] + p->geo.rot[3 + a] * p->image->trans[1] +
                                 p->geo.rot[6 + a] * p->image->trans[2]);
        for (size_t k = 0; k < p->image->n_obs; k++)
            if (p->image->obs[k].point >= 0)
                scratch[p->n_points++] = reprojection_at(g, p, &p->image->obs[k]);
        p->reprojection_px = similarity_median(scratch, p->n_points);
        if (p->verdict == INGEST_KEPT && p->n_points < (size_t)g->cfg->min_points)
            p->verdict = INGEST_FEW_POINTS;
        else if (p->verdict == INGEST_KEPT && p->reprojection_px > g->cfg->max_reprojection_px)
            p->verdict = INGEST_POSE;
    }
    mem_free(scratch);
    return ERR_OK;
}

static size_t count_verdict(const struct ingest *g, enum ingest_verdict v)
{
    size_t n = 0;
    for (size_t i = 0; i < g->n; i++)
        n += g->photos[i].verdict == v;
    return n;
}

static enum err_code check_some_left(const struct ingest *g, struct err *e)
{
    size_t few = count_verdict(g, INGEST_FEW_POINTS), pose = count_verdict(g, INGEST_POSE), most = 0;
    if (count_verdict(g, INGEST_KEPT) >= 3)
        return ERR_OK;
    for (size_t i = 0; i < g->n; i++)
        most = g->photos[i].n_points > most ? g->photos[i].n_points : most;
    return err_set(e, ERR_DATA, "no scene is left: %zu of %zu photographs see fewer than %lld points (the best one sees %zu; see "
                                "--min-points), %zu disagree with the points they see (--max-reprojection-px)",
                   few, g->n, (long long)g->cfg->min_points, most, pose);
}

/* ---- the frame -------------------------------------------------------------------------------------------- */

static enum err_code origin_parse(const char *text, struct geo_origin *o, struct err *e)
{
    char rest;
    if (sscanf(text, "%lf,%lf,%lf%c", &o->lon_deg, &o->lat_deg, &o->h_m, &rest) != 3 || !(fabs(o->lon_deg) <= 180) ||
        !(fabs(o->lat_deg) <= 90) || !(fabs(o->h_m) < 1e5))
        return err_set(e, ERR_ARG, "--origin: '%.80s' is not LON,LAT,H in degrees and metres", text);
    return ERR_OK;
}

static bool gps_usable(const struct image_gps *g)
{
    return g->has_position && g->has_altitude && isfinite(g->alt_m) && fabs(g->lat_deg) <= 90 && fabs(g->lon_deg) <= 180 &&
           (g->lat_deg != 0 || g->lon_deg != 0);
}

/* GPS positions in the frame about `o`. */
static enum err_code gps_to_enu(struct ingest *g, const struct geo_origin *o, struct err *e)
{
    enum err_code rc = ERR_OK;
    for (size_t i = 0; rc == ERR_OK && i < g->n; i++) {
        struct ingest_photo *p = &g->photos[i];
        p->geo.has_gps = p->verdict != INGEST_MISSING && gps_usable(&p->gps);
        if (p->geo.has_gps)
            rc = geo_to_enu(o, p->gps.lon_deg, p->gps.lat_deg, p->gps.alt_m + g->cfg->geoid_offset_m, p->geo.gps_enu_m, e);
    }
    return rc;
}

/* Median longitude (counted from the first, so that the date line does no harm), latitude and height. */
static enum err_code median_place(const struct ingest *g, struct geo_origin *o, struct err *e)
{
    double *v = mem_array(g->n, 3 * sizeof *v), lon0 = 0;
    size_t n = 0;
    if (!v)
        return no_memory(e);
    for (size_t i = 0; i < g->n; i++) {
        const struct image_gps *p = &g->photos[i].gps;
        if (g->photos[i].verdict != INGEST_KEPT || !gps_usable(p))
            continue;
        lon0 = n ? lon0 : p->lon_deg;
        v[n] = remainder(p->lon_deg - lon0, 360);
        v[g->n + n] = p->lat_deg;
        v[2 * g->n + n++] = p->alt_m + g->cfg->geoid_offset_m;
    }
    *o = (struct geo_origin){remainder(lon0 + similarity_median(v, n), 360), similarity_median(v + g->n, n),
                             similarity_median(v + 2 * g->n, n)};
    mem_free(v);
    return ERR_OK;
}

static bool point_is_reliable(const struct colmap_point *p)
{
    return p->n_track >= RELIABLE_TRACK && p->error_px <= reliable_px;
}

/* Normal of the ground: the direction in which the reliable points, without the farthest, spread least. Left 0
 * when they are no flat thing. */
static enum err_code ground_normal(const struct ingest *g, double out[3], struct err *e)
{
    const struct colmap_model *m = &g->model;
    double *d = mem_array(m->n_points, sizeof *d), mean[3] = {0}, limit = HUGE_VAL, cov[9], values[3], vectors[9];
    if (!d)
        return no_memory(e);
    for (int pass = 0; pass < 4; pass++) {
        size_t n = 0;
        double sum[3] = {0};
        memset(cov, 0, sizeof cov);
        for (size_t i = 0; i < m->n_points; i++) {
            const double *x = m->points[i].xyz;
            double r[3] = {x[0] - mean[0], x[1] - mean[1], x[2] - mean[2]};
            double dist = sqrt(r[0] * r[0] + r[1] * r[1] + r[2] * r[2]);
            if (!point_is_reliable(&m->points[i]) || dist > limit)
                continue;
            d[n++] = dist;
            for (int a = 0; a < 3; a++) {
                sum[a] += x[a];
                for (int b = 0; b < 3; b++)
                    cov[3 * a + b] += r[a] * r[b];
            }
        }
        if (n < 50)
            break;
        for (int a = 0; a < 3; a++)
            mean[a] = sum[a] / (double)n;
        limit = pass ? 3 * similarity_median(d, n) : HUGE_VAL;
    }
    similarity_eigen(cov, 3, values, vectors);
    if (values[0] < 0.1 * values[1])
        memcpy(out, vectors, 3 * sizeof *out);
    mem_free(d);
    return ERR_OK;
}

static double median_height(const struct ingest *g, const struct similarity *s, double *scratch)
{
    const struct colmap_model *m = &g->model;
    size_t step = m->n_points / HEIGHT_SAMPLES + 1, n = 0;
    for (size_t i = 0; i < m->n_points; i += step) {
        double y[3];
        if (!point_is_reliable(&m->points[i]))
            continue;
        similarity_apply(s, m->points[i].xyz, y);
        scratch[n++] = y[2];
    }
    return similarity_median(scratch, n);
}

/* The same similarity told in the frame of another origin: a rotation and a shift by way of ECEF. */
static enum err_code move_frame(struct similarity *s, const struct geo_origin *from, const struct geo_origin *to,
                                struct err *e)
{
    double a[16], b[16], turn[9], shift[3], rot[9], trans[3];
    enum err_code rc = geo_enu_to_ecef(from, a, e);
    if (rc == ERR_OK)
        rc = geo_enu_to_ecef(to, b, e);
    if (rc != ERR_OK)
        return rc;
    for (int i = 0; i < 3; i++) {
        shift[i] = 0;
        for (int k = 0; k < 3; k++)
            shift[i] += b[4 * i + k] * (a[12 + k] - b[12 + k]);
        for (int j = 0; j < 3; j++) {
            turn[3 * i + j] = 0;
            for (int k = 0; k < 3; k++)
                turn[3 * i + j] += b[4 * i + k] * a[4 * j + k];
        }
    }
    for (int i = 0; i < 3; i++) {
        trans[i] = shift[i];
        for (int j = 0; j < 3; j++) {
            trans[i] += turn[3 * i + j] * s->trans[j];
            rot[3 * i + j] = 0;
            for (int k = 0; k < 3; k++)
                rot[3 * i + j] += turn[3 * i + k] * s->rot[3 * k + j];
        }
    }
    memcpy(s->rot, rot, sizeof rot);
    memcpy(s->trans, trans, sizeof trans);
    return ERR_OK;
}

/* Middle of the kept photographs by GPS, to 1e-7 degrees; the median point's height, to 1 cm. */
static enum err_code choose_origin(const struct ingest *g, const struct geo_origin *from, const struct similarity *s,
                                   struct geo_origin *out, struct err *e)
{
    double lo[2] = {HUGE_VAL, HUGE_VAL}, hi[2] = {-HUGE_VAL, -HUGE_VAL}, mid[3] = {0}, h;
    for (size_t i = 0; i < g->n; i++)
        for (int a = 0; a < 2 && g->photos[i].geo.has_gps && g->photos[i].verdict == INGEST_KEPT; a++) {
            lo[a] = fmin(lo[a], g->photos[i].geo.gps_enu_m[a]);
            hi[a] = fmax(hi[a], g->photos[i].geo.gps_enu_m[a]);
        }
    double *scratch = mem_array(g->model.n_points < HEIGHT_SAMPLES ? g->model.n_points : 2 * HEIGHT_SAMPLES, sizeof *scratch);
    if (!scratch)
        return no_memory(e);
    mid[0] = 0.5 * (lo[0] + hi[0]);
    mid[1] = 0.5 * (lo[1] + hi[1]);
    mid[2] = median_height(g, s, scratch);
    mem_free(scratch);
    enum err_code rc = geo_from_enu(from, mid, &out->lon_deg, &out->lat_deg, &h, e);
    out->lon_deg = round(out->lon_deg * 1e7) / 1e7;
    out->lat_deg = round(out->lat_deg * 1e7) / 1e7;
    out->h_m = round(h * 100) / 100;
    return rc;
}

/* Run georef_fit on the photographs still kept, write its verdicts back. */
static enum err_code fit_kept(struct ingest *g, struct err *e)
{
    struct georef_config cfg = {.inlier_m = inlier_m, .tau_min_m = g->cfg->tau_min_m,
                                .tau_max_m = fmax(g->cfg->tau_max_m, g->cfg->tau_min_m), .seed = 1};
    struct georef_photo *list = mem_array(g->n, sizeof *list);
    size_t n = 0;
    enum err_code rc = list ? ground_normal(g, cfg.ground_normal, e) : no_memory(e);
    for (size_t i = 0; rc == ERR_OK && i < g->n; i++)
        if (g->photos[i].verdict == INGEST_KEPT)
            list[n++] = g->photos[i].geo;
    if (rc == ERR_OK)
        rc = georef_fit(list, n, &cfg, &g->georef, e);
    n = 0;
    for (size_t i = 0; rc == ERR_OK && i < g->n; i++) {
        struct ingest_photo *p = &g->photos[i];
        if (p->verdict != INGEST_KEPT)
            continue;
        p->residual_m = g->georef.residual_m[n];
        p->flight = g->georef.flight[n];
        if (g->georef.dropped[n++])
            p->verdict = INGEST_GPS;
    }
    mem_free(list);
    return rc;
}

static enum err_code frame_from_gps(struct ingest *g, struct similarity *sim, struct err *e)
{
    struct geo_origin first, *origin = &g->scene.origin;
    enum err_code rc = median_place(g, &first, e);
    if (rc == ERR_OK)
        rc = gps_to_enu(g, &first, e);
    if (rc == ERR_OK)
        rc = fit_kept(g, e);
    if (rc != ERR_OK)
        return rc;
    g->fitted = true;
    *sim = g->georef.sim;
    rc = g->cfg->origin ? origin_parse(g->cfg->origin, origin, e) : choose_origin(g, &first, sim, origin, e);
    if (rc == ERR_OK)
        rc = move_frame(sim, &first, origin, e);
    if (rc == ERR_OK)
        rc = gps_to_enu(g, origin, e);
    size_t n = 0;
    double sum = 0;
    for (size_t i = 0; i < g->n; i++)
        if (g->photos[i].verdict == INGEST_KEPT && g->photos[i].geo.has_gps) {
            sum += g->georef.flight_offset_m[g->photos[i].flight];
            n++;
        }
    g->scene.vertical_offset_m = (n ? sum / (double)n : 0) - g->cfg->geoid_offset_m;
    return rc;
}

static enum err_code frame_by_hand(struct ingest *g, size_t n_gps, size_t n_kept, struct similarity *sim, struct err *e)
{
    double normal[3] = {0};
    if (!g->cfg->origin || !(g->cfg->metres_per_unit > 0))
        return err_set(e, ERR_DATA, "%zu of %zu photographs have a GPS position with altitude: too few to georeference. Give "
                                    "photographs with EXIF GPS, or place the scene by hand with --origin LON,LAT,H and "
                                    "--metres-per-unit%s", n_gps, n_kept, n_gps >= 3 ? ", or accept fewer with --min-gps-share" : "");
    log_warn("ingest", "frame by hand: %zu of %zu photographs have GPS; no positions were checked, north is arbitrary", n_gps, n_kept);
    enum err_code rc = origin_parse(g->cfg->origin, &g->scene.origin, e);
    struct georef_photo *list = mem_array(g->n, sizeof *list);
    double *scratch = mem_array(g->model.n_points < HEIGHT_SAMPLES ? g->model.n_points : 2 * HEIGHT_SAMPLES, sizeof *scratch);
    size_t n = 0;
    if (rc == ERR_OK && (!list || !scratch))
        rc = no_memory(e);
    for (size_t i = 0; rc == ERR_OK && i < g->n; i++)
        if (g->photos[i].verdict == INGEST_KEPT)
            list[n++] = g->photos[i].geo;
    if (rc == ERR_OK)
        rc = ground_normal(g, normal, e);
    if (rc == ERR_OK)
        rc = georef_upright(list, n, normal, g->cfg->metres_per_unit, sim, e);
    if (rc == ERR_OK)
        sim->trans[2] -= median_height(g, sim, scratch);
    mem_free(list);
    mem_free(scratch);
    return rc;
}

static enum err_code find_frame(struct ingest *g, struct err *e)
{
    struct similarity sim = {0};
    size_t n_gps = 0, n_kept = 0;
    for (size_t i = 0; i < g->n; i++)
        if (g->photos[i].verdict == INGEST_KEPT) {
            n_kept++;
            n_gps += gps_usable(&g->photos[i].gps);
        }
    bool enough = n_gps >= 3 && (double)n_gps >= g->cfg->min_gps_share * (double)n_kept;
    enum err_code rc = enough ? frame_from_gps(g, &sim, e) : frame_by_hand(g, n_gps, n_kept, &sim, e);
    g->scene.scale = sim.scale;
    memcpy(g->scene.rot, sim.rot, sizeof sim.rot);
    memcpy(g->scene.trans, sim.trans, sizeof sim.trans);
    return rc;
}

/* ---- the scene -------------------------------------------------------------------------------------------- */

/* The view of a photograph: one for each camera and size. */
static enum err_code find_view(struct ingest *g, struct ingest_photo *p, struct err *e)
{
    const struct lens *l = &g->model.cameras[p->image->camera].lens;
    for (size_t k = 0; k < g->n_views; k++) {
        const struct ingest_view *v = &g->views[k];
        if (v->camera == p->image->camera && v->lens.width_px == p->width_px && v->lens.height_px == p->height_px) {
            p->view = (uint32_t)k;
            return ERR_OK;
        }
    }
    uint32_t edge = (uint32_t)g->cfg->max_edge_px;
    enum err_code rc = ingest_view_make(l, p->width_px, p->height_px, edge, &g->views[g->n_views], e);
    if (rc != ERR_OK) {
        err_add(e, "camera %u", g->model.cameras[p->image->camera].id);
        return rc;
    }
    g->views[g->n_views].camera = p->image->camera;
    p->view = (uint32_t)g->n_views++;
    return ERR_OK;
}

static void scene_image_fill(const struct ingest *g, size_t i, uint32_t group, struct scene_image *out)
{
    const struct ingest_photo *p = &g->photos[i];
    const struct scene *s = &g->scene;
    bool test = g->cfg->test_every > 0 && i % (size_t)g->cfg->test_every == 0;
    *out = (struct scene_image){.name = p->out_name, .cam = g->views[p->view].pinhole, .group = group,
                                .split = test ? SCENE_TEST : SCENE_TRAIN, .residual_m = p->residual_m};
    for (int a = 0; a < 3; a++) { /* W' = W R^T, d' = s d - W' t */
        out->gps_enu_m[a] = p->geo.has_gps ? p->geo.gps_enu_m[a] : (double)NAN;
        for (int b = 0; b < 3; b++)
            out->cam.rot[3 * a + b] = p->geo.rot[3 * a] * s->rot[3 * b] + p->geo.rot[3 * a + 1] * s->rot[3 * b + 1] +
                                      p->geo.rot[3 * a + 2] * s->rot[3 * b + 2];
        out->cam.trans[a] = s->scale * p->image->trans[a];
        for (int b = 0; b < 3; b++)
            out->cam.trans[a] -= out->cam.rot[3 * a + b] * s->trans[b];
    }
}

static enum err_code fill_images(struct ingest *g, struct err *e)
{
    struct scene *s = &g->scene;
    s->images = arena_get(&s->arena, g->n, sizeof *s->images);
    g->views = arena_get(&s->arena, g->n, sizeof *g->views);
    if (!s->images || !g->views)
        return no_memory(e);
    for (size_t i = 0; i < g->n; i++)
        g->kept[i] = UINT32_MAX;
    for (size_t i = 0; i < g->n; i++) {
        if (g->photos[i].verdict != INGEST_KEPT)
            continue;
        enum err_code rc = find_view(g, &g->photos[i], e);
        if (rc != ERR_OK)
            return rc;
        g->kept[g->photos[i].image - g->model.images] = (uint32_t)s->n_images;
        scene_image_fill(g, i, (uint32_t)s->n_images, &s->images[s->n_images]);
        s->n_images++;
    }
    return ERR_OK;
}

static int track_compare(const void *a, const void *b)
{
    const struct scene_track *p = a, *q = b;
    if (p->image != q->image)
        return p->image < q->image ? -1 : 1;
    return (p->point > q->point) - (p->point < q->point);
}

/* Points with the observations of kept photographs; a point that nobody sees any more is left out. */
static enum err_code fill_points(struct ingest *g, struct err *e)
{
    struct scene *s = &g->scene;
    const struct colmap_model *m = &g->model;
    const struct similarity sim = {s->scale, {s->rot[0], s->rot[1], s->rot[2], s->rot[3], s->rot[4], s->rot[5], s->rot[6],
                                              s->rot[7], s->rot[8]}, {s->trans[0], s->trans[1], s->trans[2]}};
    s->points = arena_get(&s->arena, m->n_points, sizeof *s->points);
    s->tracks = arena_get(&s->arena, m->n_tracks, sizeof *s->tracks);
    uint32_t *view_of = mem_array(m->n_images, sizeof *view_of);
    if (!s->points || !s->tracks || !view_of) {
        mem_free(view_of);
        return no_memory(e);
    }
    for (size_t i = 0; i < g->n; i++)
        view_of[g->photos[i].image - m->images] = g->photos[i].view;
    for (size_t i = 0; i < m->n_points; i++) {
        const struct colmap_point *p = &m->points[i];
        struct scene_point *out = &s->points[s->n_points];
        size_t seen = 0;
        for (size_t k = 0; k < p->n_track; k++) {
            const struct colmap_track_element *t = &m->tracks[p->track + k];
            if (g->kept[t->image] == UINT32_MAX)
                continue;
            seen++;
            const struct colmap_observation *o = &m->images[t->image].obs[t->obs];
            double u, v;
            if (ingest_view_map(&g->views[view_of[t->image]], &m->cameras[m->images[t->image].camera].lens, o->x_px,
                                o->y_px, &u, &v))
                s->tracks[s->n_tracks++] = (struct scene_track){(uint32_t)s->n_points, g->kept[t->image], (float)u, (float)v};
        }
        if (!seen)
            continue;
        *out = (struct scene_point){.error_px = (float)p->error_px, .track_length = (uint32_t)seen};
        memcpy(out->rgb, p->rgb, sizeof out->rgb);
        similarity_apply(&sim, p->xyz, out->enu_m);
        s->n_points++;
    }
    mem_free(view_of);
    qsort(s->tracks, s->n_tracks, sizeof *s->tracks, track_compare);
    return ERR_OK;
}

static enum err_code convert_task(void *user, size_t i, struct err *e)
{
    struct ingest *g = user;
    const struct ingest_photo *p = &g->photos[i];
    char from[FILE_PATH_MAX], to[FILE_PATH_MAX], folder[FILE_PATH_MAX];
    struct codec_limits lim = {0};
    enum err_code rc = ERR_OK;
    if (clock_stopping())
        return err_set(e, ERR_CANCEL, "stopped");
    if (p->verdict == INGEST_KEPT) {
        rc = file_join(from, g->images_dir, p->image->name, e);
        if (rc == ERR_OK)
            rc = file_join(folder, g->dir.part, "images", e);
        if (rc == ERR_OK)
            rc = file_join(to, folder, p->out_name, e);
        if (rc == ERR_OK)
            rc = ingest_photo_convert(&g->views[p->view], from, to, &lim, e);
    }
    step_done(g);
    return rc;
}

static enum err_code count_unregistered(const struct ingest *g, size_t *out, struct err *e)
{
    static const char *const suffixes[] = {".jpg", ".jpeg", ".png", ".tif", ".tiff", ".webp", NULL};
    struct arena a = {0};
    char **names;
    size_t n, in_top = 0;
    enum err_code rc = file_list(g->images_dir, suffixes, &a, &names, &n, e);
    for (size_t i = 0; rc == ERR_OK && i < g->n; i++)
        in_top += g->photos[i].verdict != INGEST_MISSING && !strchr(g->photos[i].image->name, '/');
    *out = rc == ERR_OK && n > in_top ? n - in_top : 0;
    arena_free(&a);
    return rc;
}

static enum err_code write_scene(struct ingest *g, double start_s, struct err *e)
{
    char path[FILE_PATH_MAX];
    struct ingest_result r = {.cfg = g->cfg, .photos = g->photos, .n_photos = g->n, .n_kept = g->scene.n_images,
                              .scene = &g->scene, .georef = g->fitted ? &g->georef : NULL};
    for (size_t i = 0; i < g->scene.n_images; i++)
        *(g->scene.images[i].split == SCENE_TEST ? &r.n_test : &r.n_train) += 1;
    for (size_t i = 0; i < g->n; i++)
        r.n_gps += g->photos[i].geo.has_gps;
    enum err_code rc = count_unregistered(g, &r.n_unregistered, e);
    if (rc == ERR_OK)
        rc = scene_write(g->dir.part, &g->scene, e);
    if (rc == ERR_OK)
        rc = file_join(path, g->dir.part, "report.json", e);
    r.seconds = clock_s() - start_s;
    if (rc == ERR_OK)
        rc = ingest_report_write(&r, path, e);
    if (rc == ERR_OK)
        rc = outdir_commit(&g->dir, e);
    if (rc == ERR_OK)
        ingest_report_print(&r);
    return rc;
}

static enum err_code run_steps(struct ingest *g, const char *sparse_dir, double start_s, struct err *e)
{
    char folder[FILE_PATH_MAX];
    enum err_code rc = colmap_read(sparse_dir, &g->model, e);
    if (rc == ERR_OK)
        rc = list_photos(g, e);
    if (rc == ERR_OK)
        rc = for_photos(g, "read EXIF", read_info_task, e);
    if (rc == ERR_OK)
        rc = find_flights(g, e);
    if (rc == ERR_OK)
        rc = judge_poses(g, e);
    if (rc == ERR_OK)
        rc = check_some_left(g, e);
    if (rc == ERR_OK)
        rc = find_frame(g, e);
    if (rc == ERR_OK)
        rc = fill_images(g, e);
    if (rc == ERR_OK)
        rc = fill_points(g, e);
    if (rc == ERR_OK)
        rc = file_join(folder, g->dir.part, "images", e);
    if (rc == ERR_OK)
        rc = file_mkdir(folder, e);
    if (rc == ERR_OK)
        rc = for_photos(g, "undistort and shrink", convert_task, e);
    if (rc == ERR_OK)
        rc = write_scene(g, start_s, e);
    return rc;
}

enum err_code ingest_run(const char *images_dir, const char *sparse_dir, const struct ingest_config *cfg, struct err *e)
{
    struct ingest g = {.cfg = cfg, .images_dir = images_dir, .progress_busy = ATOMIC_FLAG_INIT};
    struct geo_origin ignored;
    double start_s = clock_s();
    if (!cfg->output)
        return err_set(e, ERR_ARG, "ingest: no output folder: give -o SCENE");
    enum err_code rc = cfg->origin ? origin_parse(cfg->origin, &ignored, e) : ERR_OK;
    if (rc == ERR_OK)
        rc = outdir_begin(cfg->output, "scene.json", cfg->overwrite, &g.dir, e);
    if (rc != ERR_OK)
        return rc;
    if (cfg->attribution && !(g.scene.attribution = arena_text(&g.scene.arena, cfg->attribution)))
        rc = no_memory(e);
    if (rc == ERR_OK)
        rc = run_steps(&g, sparse_dir, start_s, e);
    outdir_abort(&g.dir);
    georef_free(&g.georef);
    colmap_free(&g.model);
    scene_free(&g.scene);
    return rc;
}
