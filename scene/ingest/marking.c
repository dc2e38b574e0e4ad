/* Marks ground control points in photographs: see marking.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "scene/ingest/marking.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "scene/control/gcp_solve.h"
#include "scene/control/table.h"
#include "scene/ingest/ingest.h"

static const double ground_sigma = 0.2; /* rad: how far GPS may put up off */
/* Errors of marks, over what people do: with few points a wrong mark would excuse itself. */
static const double marks_factor_most = 4;
enum { MARKING_FILE_MAX = 64 << 20 };

struct marking {
    struct marking_config cfg;
    char output[FILE_PATH_MAX];
    struct ingest_survey survey;
    struct gcp_list list;
    char **written;          /* [survey.n] how new marks name the photograph */
    struct gcp_view *views;  /* [survey.n] */
    double up[3];            /* in COLMAP's frame; 0 0 0: not known */
    double (*surveyed_m)[3]; /* [list.n] in the frame of `origin` */
    struct geo_origin origin;
    struct gcp_places places;
    struct sim3 sim;     /* COLMAP -> ENU about origin */
    bool placed;         /* sim is known */
    double (*off_m)[2];  /* [list.n] */
    struct hash128 file; /* of the bytes that were written or read last */
    bool there;          /* that file exists */
    size_t strays;
    uint64_t revision;
};

static enum err_code marking_no_memory(struct err *e)
{
    return err_set(e, ERR_MEM, "out of memory for marks");
}

/* ---- the file ---- */

/* As it is now on the disk. */
static enum err_code marking_look_at_file(const struct marking *m, struct hash128 *hash,
                                          bool *there, struct err *e)
{
    struct buf b = {0};
    *hash = (struct hash128){0};
    *there = file_exists(m->output);
    enum err_code rc = *there ? file_read(m->output, MARKING_FILE_MAX, &b, e) : ERR_OK;
    if (!rc)
        *hash = hash_bytes(b.data, b.size);
    buf_free(&b);
    return rc;
}

static enum err_code marking_save(struct marking *m, struct err *e)
{
    struct buf b = {0};
    struct hash128 now;
    bool there;
    enum err_code rc = marking_look_at_file(m, &now, &there, e);
    if (!rc && (there != m->there || now.lo != m->file.lo || now.hi != m->file.hi))
        rc = err_set(e, ERR_BUSY,
                     "%s was changed by another program since it was read: nothing was written",
                     m->output);
    if (!rc)
        rc = gcp_write(&m->list, gcp_form_of(m->output), &b, e);
    if (!rc)
        rc = file_write(m->output, b.data, b.size, e);
    if (!rc) {
        m->file = hash_bytes(b.data, b.size);
        m->there = true;
    }
    buf_free(&b);
    return rc;
}

/* ---- places ---- */

static void marking_tie(const struct marking *m, size_t i, struct gcp_tie *t)
{
    const struct gcp_place *p = &m->places.places[i];
    memcpy(t->x, p->x, sizeof t->x);
    memcpy(t->cov, p->cov, sizeof t->cov);
    memcpy(t->y, m->surveyed_m[i], sizeof t->y);
    for (size_t k = 0; k < 2; k++) {
        double sigma = m->list.gcps[i].sigma_m[k];
        sigma = sigma > 0 ? sigma : m->cfg.sigma_m;
        t->var_m[k] = sigma * sigma;
    }
}

/* Is the point where two marks or more place it? */
static bool marking_fixed(const struct marking *m, size_t i)
{
    const struct gcp_place *p = &m->places.places[i];
    return p->n_photos >= 2 && !p->by_points;
}

/* The frame of GPS, moved so that the points lie on their marks in the mean: its heights may count
 * from elsewhere. */
static void marking_shift(struct marking *m, const struct gcp_tie *ties, size_t n)
{
    double shift[3] = {0}, y[3];
    m->placed = m->survey.placed;
    m->sim = m->survey.sim;
    for (size_t i = 0; i < n; i++) {
        sim3_apply(&m->sim, ties[i].x, y);
        for (size_t k = 0; k < 3; k++)
            shift[k] += (ties[i].y[k] - y[k]) / (double)n;
    }
    for (size_t k = 0; k < 3; k++)
        m->sim.trans[k] += shift[k];
}

static enum err_code marking_fit(struct marking *m, struct err *e)
{
    struct gcp_tie *ties = mem_array(m->list.n, sizeof *ties);
    struct gcp_solution s;
    bool fixed = false;
    size_t n = 0;
    enum err_code rc = ties ? ERR_OK : marking_no_memory(e);
    for (size_t i = 0; !rc && i < m->list.n; i++) {
        m->off_m[i][0] = m->off_m[i][1] = (double)NAN;
        if (marking_fixed(m, i))
            marking_tie(m, i, &ties[n++]);
    }
    if (!rc && n >= 3)
        rc = gcp_solve(ties, n, m->up, m->survey.placed ? ground_sigma : 0, true, &s, &fixed, e);
    if (!rc && !fixed)
        marking_shift(m, ties, n);
    for (size_t i = 0, k = 0; !rc && fixed && i < m->list.n; i++) {
        struct gcp_left left;
        if (!marking_fixed(m, i))
            continue;
        gcp_solve_leave_out(&s, &ties[k++], &left);
        m->off_m[i][0] = hypot(left.residual_m[0], left.residual_m[1]);
        m->off_m[i][1] = left.residual_m[2];
    }
    if (!rc && fixed) {
        m->placed = true;
        m->sim = s.sim;
    }
    mem_free(ties);
    return rc;
}

static enum err_code marking_solve(struct marking *m, struct err *e)
{
    struct gcp_places places;
    enum err_code rc =
        gcp_locate(&m->list, &m->survey.model, m->views, m->survey.n, m->cfg.px_scale,
                   m->cfg.mark_px, m->up, false, marks_factor_most, &places, e);
    if (rc)
        return rc;
    gcp_places_free(&m->places);
    m->places = places;
    return marking_fit(m, e);
}

/* Where the point lies in COLMAP's frame. */
static enum marking_source marking_place(const struct marking *m, size_t point, double x[3])
{
    const struct gcp_place *p = &m->places.places[point];
    if (p->n_photos) {
        memcpy(x, p->x, sizeof p->x);
        return p->by_points ? MARKING_ONE : MARKING_MARKS;
    }
    if (!m->placed)
        return MARKING_NOWHERE;
    const double *y = m->surveyed_m[point], *r = m->sim.rot;
    for (size_t k = 0; k < 3; k++) {
        x[k] = 0;
        for (size_t a = 0; a < 3; a++)
            x[k] += r[3 * a + k] * (y[a] - m->sim.trans[a]) / m->sim.scale;
    }
    return MARKING_FRAME;
}

/* Pixels of the photograph's file for each of COLMAP's. */
static double marking_file_scale(const struct ingest_survey_photo *p)
{
    return (double)p->width_px / p->view.lens->width_px;
}

/* Where a place is in a photograph; false: it is not. */
static bool marking_project(const struct ingest_survey_photo *p, const double x[3], double px[2])
{
    const struct gcp_view *v = &p->view;
    double t[3], u, w, back[2];
    for (size_t a = 0; a < 3; a++) {
        t[a] = 0;
        for (size_t k = 0; k < 3; k++)
            t[a] += v->rot[3 * a + k] * (x[k] - v->center[k]);
    }
    if (!(t[2] > 0))
        return false;
    lens_distort(v->lens, t[0] / t[2], t[1] / t[2], &u, &w);
    /* far outside of the picture polynomials lead back into it */
    if (!(u >= 0 && w >= 0 && u <= v->lens->width_px && w <= v->lens->height_px) ||
        !lens_undistort(v->lens, u, w, &back[0], &back[1]) ||
        hypot(back[0] - t[0] / t[2], back[1] - t[1] / t[2]) > 1e-3)
        return false;
    px[0] = u * marking_file_scale(p);
    px[1] = w * marking_file_scale(p);
    return true;
}

/* ---- opening ---- */

/* What a file of a form cannot hold. */
static const struct {
    const char *file, *photo, *point;
} marking_form[] = {
    [GCP_FORM_ODM] = {"a gcp_list.txt",
                      "it has a blank, a comma, or 256 bytes and more; give -o FILE.csv",
                      "give -o FILE.csv, which may have blanks"},
    [GCP_FORM_CSV] = {"a list in CSV", "it has a comma, a semicolon, or 256 bytes and more",
                      "it has a comma or a semicolon; give -o FILE.xml"},
    [GCP_FORM_XML] = {"a list in XML", "it has a control character, or 256 bytes and more",
                      "it has a control character"},
};

/* Photographs are called as the list calls them: by their file's name, with its folder where two
 * have one name. Metashape's labels lack the ending. */
static enum err_code marking_name_photos(struct marking *m, bool endings, struct err *e)
{
    const struct ingest_survey *s = &m->survey;
    const enum gcp_form form = gcp_form_of(m->output);
    for (size_t i = 0; i < s->n; i++) {
        const char *name = s->photos[i].view.image->name, *slash = strrchr(name, '/');
        size_t alike = 0;
        m->views[i] = s->photos[i].view;
        const char *short_name = slash ? slash + 1 : name;
        for (size_t k = 0; k < s->model.n_images; k++)
            alike += table_alike(s->model.images[k].name, short_name) > 0;
        m->written[i] = mem_text(alike > 1 ? name : short_name);
        if (!m->written[i])
            return marking_no_memory(e);
        char *dot = strrchr(m->written[i], '.');
        if (!endings && dot && dot > m->written[i] && !strchr(dot, '/'))
            *dot = '\0';
        if (strlen(m->written[i]) >= GCP_IMAGE_MAX || !gcp_name_fits(form, m->written[i]))
            return err_set(e, ERR_DATA, "photograph '%.200s': %s cannot hold this name: %s",
                           m->written[i], marking_form[form].file, marking_form[form].photo);
    }
    return ERR_OK;
}

static enum err_code marking_check_points(struct marking *m, struct err *e)
{
    const enum gcp_form form = gcp_form_of(m->output);
    for (size_t i = 0; i < m->list.n; i++)
        if (!gcp_name_fits(form, m->list.gcps[i].name))
            return err_set(e, ERR_DATA,
                           "ground control point '%s': the output cannot hold this name; %s",
                           m->list.gcps[i].name, marking_form[form].point);
    return ERR_OK;
}

/* Are photographs called with their endings? Not in a new file for Metashape, which labels them
 * without; one of before keeps what it has. */
static bool marking_has_endings(const struct marking *m)
{
    if (gcp_form_of(m->output) != GCP_FORM_XML)
        return true;
    return m->there && m->list.n_marks && strchr(m->list.marks[0].image, '.');
}

/* One photograph has one label in Metashape's file. */
static enum err_code marking_name_marks(struct marking *m, struct err *e)
{
    for (size_t k = 0; k < m->list.n_marks; k++) {
        const struct colmap_image *im;
        enum err_code rc = gcp_locate_photo(&m->survey.model, &m->list, &m->list.marks[k], &im, e);
        if (rc)
            return rc;
        for (size_t i = 0; im && i < m->survey.n; i++)
            if (m->survey.photos[i].view.image == im)
                memcpy(m->list.marks[k].image, m->written[i], strlen(m->written[i]) + 1);
    }
    return ERR_OK;
}

/* Points in metres: about the survey's origin, or without one about the first point. */
static enum err_code marking_survey_points(struct marking *m, struct err *e)
{
    enum err_code rc = ERR_OK;
    m->origin = m->survey.origin;
    if (!m->survey.placed && m->list.n) {
        const double *at = m->list.gcps[0].at;
        m->origin = (struct geo_origin){at[0], at[1], at[2]};
    }
    for (size_t i = 0; !rc && i < m->list.n; i++) {
        const double *at = m->list.gcps[i].at;
        rc = geo_to_enu(&m->origin, at[0], at[1], at[2], m->surveyed_m[i], e);
        if (rc)
            err_add(e, "ground control point %s", m->list.gcps[i].name);
    }
    return rc;
}

static enum err_code marking_count_strays(struct marking *m, struct err *e)
{
    enum err_code rc = ERR_OK;
    for (size_t k = 0; !rc && k < m->list.n_marks; k++) {
        const struct colmap_image *im;
        rc = gcp_locate_photo(&m->survey.model, &m->list, &m->list.marks[k], &im, e);
        m->strays += !rc && !im;
    }
    return rc;
}

enum err_code marking_open(const struct marking_config *cfg, struct ingest_survey *survey,
                           struct gcp_list *list, struct marking **out, struct err *e)
{
    struct marking *m = mem_array(1, sizeof *m);
    *out = NULL;
    enum err_code rc = m ? ERR_OK : marking_no_memory(e);
    if (rc) {
        ingest_survey_free(survey);
        gcp_free(list);
        return rc;
    }
    m->cfg = *cfg;
    m->survey = *survey;
    m->list = *list;
    *survey = (struct ingest_survey){0};
    *list = (struct gcp_list){0};
    m->written = mem_array(m->survey.n, sizeof *m->written);
    m->views = mem_array(m->survey.n, sizeof *m->views);
    m->surveyed_m = mem_array(m->list.n, sizeof *m->surveyed_m);
    m->off_m = mem_array(m->list.n, sizeof *m->off_m);
    if (!m->written || !m->views || !m->surveyed_m || !m->off_m)
        rc = marking_no_memory(e);
    else if (strlen(cfg->output) >= sizeof m->output)
        rc = err_set(e, ERR_LIMIT, "%.80s...: path too long", cfg->output);
    else
        memcpy(m->output, cfg->output, strlen(cfg->output) + 1);
    if (m->survey.placed)
        memcpy(m->up, m->survey.sim.rot + 6, sizeof m->up);
    if (!rc)
        rc = marking_look_at_file(m, &m->file, &m->there, e);
    if (!rc)
        rc = marking_name_photos(m, marking_has_endings(m), e);
    if (!rc && gcp_form_of(m->output) == GCP_FORM_XML)
        rc = marking_name_marks(m, e);
    if (!rc)
        rc = marking_check_points(m, e);
    if (!rc)
        rc = marking_survey_points(m, e);
    if (!rc)
        rc = marking_count_strays(m, e);
    if (!rc)
        rc = marking_solve(m, e);
    if (rc)
        marking_close(&m);
    *out = m;
    return rc;
}

void marking_close(struct marking **out)
{
    struct marking *m = *out;
    *out = NULL;
    if (!m)
        return;
    gcp_places_free(&m->places);
    gcp_free(&m->list);
    for (size_t i = 0; i < m->survey.n && m->written; i++)
        mem_free(m->written[i]);
    ingest_survey_free(&m->survey);
    mem_free(m->written);
    mem_free(m->views);
    mem_free(m->surveyed_m);
    mem_free(m->off_m);
    mem_free(m);
}

const struct ingest_survey *marking_survey(const struct marking *m)
{
    return &m->survey;
}

const struct gcp_list *marking_list(const struct marking *m)
{
    return &m->list;
}

uint64_t marking_revision(const struct marking *m)
{
    return m->revision;
}

size_t marking_strays(const struct marking *m)
{
    return m->strays;
}

/* ---- how things stand ---- */

/* Pixels of the photograph's file from a mark to the place x. */
static double marking_residual(const struct marking *m, const struct gcp_sight *s,
                               const double x[3])
{
    const struct ingest_survey_photo *p = &m->survey.photos[s->view - m->views];
    const double scale = marking_file_scale(p);
    double px[2];
    if (!marking_project(p, x, px))
        return s->residual_px / m->cfg.px_scale * scale;
    return hypot(px[0] - s->x_px * scale, px[1] - s->y_px * scale);
}

struct marking_point marking_point(const struct marking *m, size_t point)
{
    const struct gcp_place *p = &m->places.places[point];
    struct marking_point out = {.worst_px = (double)NAN,
                                .off_m = {m->off_m[point][0], m->off_m[point][1]}};
    double x[3];
    out.source = marking_place(m, point, x);
    for (size_t k = 0; k < m->list.n_marks; k++)
        out.marks += m->list.marks[k].gcp == point;
    for (size_t k = 0; k < p->n; k++) {
        const struct gcp_sight *s = &m->places.sights[p->first + k];
        out.suspects += s->suspect;
        if (out.source == MARKING_MARKS)
            out.worst_px = fmax(out.worst_px, marking_residual(m, s, x));
    }
    return out;
}

/* The mark of a point in a photograph, SIZE_MAX: none. */
static size_t marking_find(const struct marking *m, size_t point, size_t photo)
{
    for (size_t k = 0; k < m->list.n_marks; k++)
        if (m->list.marks[k].gcp == point &&
            table_alike(m->survey.photos[photo].view.image->name, m->list.marks[k].image)) {
            const struct colmap_image *im;
            if (!gcp_locate_photo(&m->survey.model, &m->list, &m->list.marks[k], &im, NULL) &&
                im == m->survey.photos[photo].view.image)
                return k;
        }
    return SIZE_MAX;
}

/* x: where the point lies. */
static void marking_fill_mark(const struct marking *m, size_t mark, const double x[3],
                              struct marking_spot *s)
{
    const struct gcp_mark *at = &m->list.marks[mark];
    const struct gcp_place *p = &m->places.places[at->gcp];
    const struct ingest_survey_photo *photo = &m->survey.photos[s->photo];
    const double scale = marking_file_scale(photo) / m->cfg.px_scale;
    s->marked = s->lost = true;
    s->marked_px[0] = at->x_px * scale;
    s->marked_px[1] = at->y_px * scale;
    for (size_t k = 0; k < p->n; k++) {
        const struct gcp_sight *sight = &m->places.sights[p->first + k];
        if (sight->mark != at)
            continue;
        s->lost = false;
        s->suspect = sight->suspect;
        s->out_px = sight->out_px * scale;
        if (marking_fixed(m, at->gcp))
            s->residual_px = marking_residual(m, sight, x);
    }
}

static int marking_spot_compare(const void *a, const void *b)
{
    const struct marking_spot *p = a, *q = b;
    if (p->middle != q->middle)
        return p->middle < q->middle ? -1 : 1;
    return (p->photo > q->photo) - (p->photo < q->photo);
}

size_t marking_spots(const struct marking *m, size_t point, struct marking_spot *spots)
{
    double x[3];
    enum marking_source source = marking_place(m, point, x);
    size_t n = 0;
    for (size_t i = 0; i < m->survey.n; i++) {
        const struct ingest_survey_photo *p = &m->survey.photos[i];
        const size_t mark = marking_find(m, point, i);
        struct marking_spot s = {
            .photo = i, .residual_px = (double)NAN, .out_px = (double)NAN, .middle = 2};
        s.expected = source != MARKING_NOWHERE && marking_project(p, x, s.expected_px);
        if (mark != SIZE_MAX)
            marking_fill_mark(m, mark, x, &s);
        const double *at = s.marked ? s.marked_px : s.expected_px;
        if (s.marked || s.expected)
            s.middle = hypot(at[0] - 0.5 * p->width_px, at[1] - 0.5 * p->height_px) /
                       (0.5 * hypot(p->width_px, p->height_px));
        if (s.marked || s.expected || source == MARKING_NOWHERE)
            spots[n++] = s;
    }
    qsort(spots, n, sizeof *spots, marking_spot_compare);
    return n;
}

/* ---- changes ---- */

static void marking_remove(struct gcp_list *l, size_t mark)
{
    memmove(&l->marks[mark], &l->marks[mark + 1], (--l->n_marks - mark) * sizeof *l->marks);
}

static enum err_code marking_apply(struct marking *m, size_t point, size_t photo, size_t mark,
                                   const double *at_px, struct err *e)
{
    const struct ingest_survey_photo *p = &m->survey.photos[photo];
    const double scale = m->cfg.px_scale / marking_file_scale(p);
    struct gcp_mark new = {.gcp = point};
    if (!at_px) {
        if (mark != SIZE_MAX)
            marking_remove(&m->list, mark);
        return ERR_OK;
    }
    if (!(at_px[0] >= 0 && at_px[1] >= 0 && at_px[0] <= p->width_px && at_px[1] <= p->height_px))
        return err_set(e, ERR_ARG, "%.1f, %.1f lies outside of %s, which is %u x %u px", at_px[0],
                       at_px[1], p->file, p->width_px, p->height_px);
    struct gcp_mark *to = mark == SIZE_MAX ? &new : &m->list.marks[mark];
    to->x_px = round(at_px[0] * scale * 1000) / 1000; /* as it is written */
    to->y_px = round(at_px[1] * scale * 1000) / 1000;
    if (mark != SIZE_MAX)
        return ERR_OK;
    memcpy(new.image, m->written[photo], strlen(m->written[photo]) + 1);
    return gcp_add_mark(&m->list, &new, e);
}

enum err_code marking_set(struct marking *m, size_t point, size_t photo, const double *at_px,
                          struct err *e)
{
    const size_t n = m->list.n_marks, mark = marking_find(m, point, photo);
    struct gcp_mark *before = mem_array(n, sizeof *before);
    struct err ignored = {0};
    if (!before)
        return marking_no_memory(e);
    memcpy(before, m->list.marks, n * sizeof *before);
    enum err_code rc = marking_apply(m, point, photo, mark, at_px, e);
    if (!rc)
        rc = marking_solve(m, e);
    if (!rc)
        rc = marking_save(m, e);
    if (!rc) {
        m->revision++;
    } else {
        memcpy(m->list.marks, before, n * sizeof *before);
        m->list.n_marks = n;
        if (marking_solve(m, &ignored))
            log_warn("mark", "%s", ignored.msg);
    }
    mem_free(before);
    return rc;
}
