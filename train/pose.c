/* Six numbers a photograph: Adam, the gauge, the file.
 *
 * The gauge: a motion of everything, a + b x r + s r at a camera that lies at r from their middle,
 * turns each camera by -b. Of the corrections e_i, w_i the part
 *     min over a, b, s of  sum |e_i - a - b x r_i - s r_i|^2 / u^2 + |w_i + b|^2
 * is taken out, u the unit of length. a is the mean of e; s and b have one and three normal
 * equations of their own, since the r add up to 0.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "train/pose.h"

#include <jansson.h>
#include <math.h>
#include <string.h>

#include "codec/scene.h"
#include "core/base.h"
#include "core/camera.h"

#define POSE_BETA1 0.9
#define POSE_BETA2 0.99 /* a photograph has tens of steps, not thousands */
#define POSE_EPS 1e-15
#define POSE_FAR 1e3 /* of a file: a correction in units that is none */
static const char pose_format[] = "citysplat-poses";

enum err_code pose_open(struct pose_set *p, const struct scene *s, const uint32_t *images,
                        size_t n_images, double unit_m, struct err *e)
{
    *p = (struct pose_set){.n = s->n_images,
                           .unit_m = unit_m,
                           .images = images,
                           .n_images = n_images,
                           .block = mem_array(s->n_images, POSE_STATE * sizeof(double)),
                           .center_m = mem_array(s->n_images, 3 * sizeof(double))};
    if (!p->block || !p->center_m) {
        pose_free(p);
        return err_set(e, ERR_MEM, "poses: out of memory for %zu photographs", s->n_images);
    }
    for (size_t i = 0; i < s->n_images; i++)
        camera_center(&s->images[i].cam, p->center_m + 3 * i);
    return ERR_OK;
}

void pose_free(struct pose_set *p)
{
    mem_free(p->block);
    mem_free(p->center_m);
    *p = (struct pose_set){0};
}

static double *pose_of(const struct pose_set *p, size_t image)
{
    return p->block + POSE_STATE * image;
}

/* rot exp([w]x). */
static void pose_turn(const double rot[9], const double w[3], double out[9])
{
    double len = sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2]), turn[9];
    double s = len > 0.0 ? sin(0.5 * len) / len : 0.5;
    const double q[4] = {cos(0.5 * len), s * w[0], s * w[1], s * w[2]};
    camera_quat_to_rot(q, turn);
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            out[3 * i + j] =
                rot[3 * i] * turn[j] + rot[3 * i + 1] * turn[3 + j] + rot[3 * i + 2] * turn[6 + j];
}

void pose_apply(const struct pose_set *p, size_t image, struct camera *cam)
{
    const double *d = p->n ? pose_of(p, image) : NULL;
    double eye[3], rot[9];
    bool moved = false;
    for (int k = 0; d && k < POSE_NUMBERS; k++)
        moved = moved || d[k] != 0.0;
    if (!moved)
        return; /* to the last bit */
    camera_center(cam, eye);
    pose_turn(cam->rot, d + 3, rot);
    memcpy(cam->rot, rot, sizeof rot);
    for (int i = 0; i < 3; i++) {
        cam->trans[i] = 0.0;
        for (int k = 0; k < 3; k++)
            cam->trans[i] -= rot[3 * i + k] * (eye[k] + d[k]);
    }
}

/* ---- steps ---- */

static void pose_cross(const double a[3], const double b[3], double out[3])
{
    for (int k = 0; k < 3; k++)
        out[k] = a[(k + 1) % 3] * b[(k + 2) % 3] - a[(k + 2) % 3] * b[(k + 1) % 3];
}

/* x of the symmetric positive m x = y, by its inverse. */
static void pose_solve(const double m[9], const double y[3], double x[3])
{
    double c[9], det = 0.0;
    for (int k = 0; k < 3; k++)
        pose_cross(m + 3 * ((k + 1) % 3), m + 3 * ((k + 2) % 3), c + 3 * k);
    for (int k = 0; k < 3; k++)
        det += m[k] * c[k];
    for (int k = 0; k < 3; k++) /* columns of the inverse are c / det */
        x[k] = (c[k] * y[0] + c[3 + k] * y[1] + c[6 + k] * y[2]) / det;
}

static void pose_middle(const struct pose_set *p, double out[3], double moved[3])
{
    for (int k = 0; k < 3; k++)
        out[k] = moved[k] = 0.0;
    for (size_t i = 0; i < p->n_images; i++)
        for (size_t k = 0; k < 3; k++) {
            out[k] += p->center_m[3 * p->images[i] + k] / (double)p->n_images;
            moved[k] += pose_of(p, p->images[i])[k] / (double)p->n_images;
        }
}

static void pose_from_middle(const struct pose_set *p, size_t image, const double middle[3],
                             double r[3])
{
    for (size_t k = 0; k < 3; k++)
        r[k] = p->center_m[3 * image + k] - middle[k];
}

/* Take out what all of them do together. */
static void pose_fix_gauge(struct pose_set *p)
{
    double middle[3], a[3], b[3], m[9] = {0}, y[3] = {0}, along = 0.0, size = 0.0;
    double per = 1.0 / (p->unit_m * p->unit_m);
    pose_middle(p, middle, a);
    for (size_t i = 0; i < p->n_images; i++) {
        const double *d = pose_of(p, p->images[i]);
        double r[3], x[3], r2 = 0.0;
        pose_from_middle(p, p->images[i], middle, r);
        pose_cross(r, d, x);
        for (int k = 0; k < 3; k++) {
            r2 += r[k] * r[k];
            along += r[k] * d[k];
            y[k] += x[k] * per - d[3 + k];
        }
        for (int k = 0; k < 9; k++)
            m[k] += (k % 4 ? 0.0 : r2 * per + 1.0) - r[k / 3] * r[k % 3] * per;
        size += r2;
    }
    pose_solve(m, y, b);
    double s = size > 0.0 ? along / size : 0.0;
    for (size_t i = 0; i < p->n_images; i++) {
        double *d = pose_of(p, p->images[i]), r[3], x[3];
        pose_from_middle(p, p->images[i], middle, r);
        pose_cross(b, r, x);
        for (int k = 0; k < 3; k++) {
            d[k] -= a[k] + x[k] + s * r[k];
            d[3 + k] += b[k];
        }
    }
}

void pose_update(struct pose_set *p, size_t image, const double grad[POSE_NUMBERS], double rate)
{
    double *d = pose_of(p, image), *m1 = d + POSE_NUMBERS, *m2 = m1 + POSE_NUMBERS;
    for (int k = 0; k < POSE_NUMBERS; k++)
        if (!isfinite(grad[k]))
            return;
    double step = ++m2[POSE_NUMBERS];
    double bias1 = 1.0 - pow(POSE_BETA1, step), bias2 = 1.0 - pow(POSE_BETA2, step);
    for (int half = 0; half < 2; half++) { /* one size a half: directions stay */
        double unit = half ? 1.0 : p->unit_m, v = 0.0;
        for (int k = 3 * half; k < 3 * half + 3; k++) {
            double g = grad[k] * unit; /* of radians either way */
            m1[k] = POSE_BETA1 * m1[k] + (1.0 - POSE_BETA1) * g;
            m2[k] = POSE_BETA2 * m2[k] + (1.0 - POSE_BETA2) * g * g;
            v += m2[k] / 3.0;
        }
        for (int k = 3 * half; k < 3 * half + 3; k++)
            d[k] -= rate * unit * (m1[k] / bias1) / (sqrt(v / bias2) + POSE_EPS);
    }
    pose_fix_gauge(p);
}

struct pose_report pose_describe(const struct pose_set *p)
{
    struct pose_report r = {0};
    double n = p->n_images ? (double)p->n_images : 1.0, deg = 180.0 / M_PI;
    for (size_t i = 0; i < p->n_images; i++) {
        const double *d = pose_of(p, p->images[i]);
        double m2 = d[0] * d[0] + d[1] * d[1] + d[2] * d[2],
               w2 = d[3] * d[3] + d[4] * d[4] + d[5] * d[5];
        r.rms_m += m2 / n;
        r.rms_deg += w2 / n;
        r.largest_m = fmax(r.largest_m, sqrt(m2));
        r.largest_deg = fmax(r.largest_deg, sqrt(w2) * deg);
    }
    r.rms_m = sqrt(r.rms_m);
    r.rms_deg = sqrt(r.rms_deg) * deg;
    return r;
}

/* ---- the file ---- */

enum err_code pose_write(const struct pose_set *p, const struct scene *s, const char *path,
                         struct err *e)
{
    json_t *list = json_array();
    bool ok = list;
    for (size_t i = 0; ok && i < p->n_images; i++) {
        const double *d = pose_of(p, p->images[i]);
        json_t *o = json_pack("{s:s, s:[f,f,f], s:[f,f,f]}", "name", s->images[p->images[i]].name,
                              "move_m", d[0], d[1], d[2], "turn_rad", d[3], d[4], d[5]);
        ok = !json_array_append_new(list, o);
    }
    json_t *root = ok ? json_pack("{s:s, s:O}", "format", pose_format, "photographs", list) : NULL;
    enum err_code rc =
        root ? jsonc_write(path, root, e) : err_set(e, ERR_MEM, "%s: out of memory", path);
    json_decref(root);
    json_decref(list);
    return rc;
}

static enum err_code pose_read_one(struct pose_set *p, const struct scene *s, const json_t *o,
                                   struct err *e)
{
    const char *name;
    double d[POSE_NUMBERS];
    enum err_code rc = jsonc_text(o, "name", &name, e);
    if (!rc)
        rc = jsonc_nums(o, "move_m", 3, d, e);
    if (!rc)
        rc = jsonc_nums(o, "turn_rad", 3, d + 3, e);
    for (int k = 0; !rc && k < POSE_NUMBERS; k++)
        if (!(fabs(d[k]) <= (k < 3 ? POSE_FAR * p->unit_m : M_PI)))
            rc = err_set(e, ERR_FORMAT, "%.80s: a correction of %g", name, d[k]);
    for (size_t i = 0; !rc && i < s->n_images; i++)
        if (!strcmp(s->images[i].name, name)) {
            memcpy(pose_of(p, i), d, sizeof d);
            return ERR_OK;
        }
    return rc ? rc
              : err_set(e, ERR_FORMAT,
                        "%.80s: the scene has no such photograph: the file is of another one",
                        name);
}

enum err_code pose_read(struct pose_set *p, const struct scene *s, const char *path, struct err *e)
{
    json_t *root = NULL;
    const char *format = NULL;
    enum err_code rc = jsonc_read(path, &root, e);
    if (rc)
        return rc;
    const json_t *list = json_object_get(root, "photographs");
    rc = jsonc_text(root, "format", &format, e);
    if (!rc && (strcmp(format, pose_format) || !json_is_array(list)))
        rc = err_set(e, ERR_FORMAT, "is no file of poses as training writes them");
    for (size_t i = 0; !rc && i < json_array_size(list); i++)
        rc = pose_read_one(p, s, json_array_get(list, i), e);
    json_decref(root);
    return rc ? err_add(e, "%s", path) : ERR_OK;
}
