/* The terms of the loss as a list: a new one is run where its row says, beside the others.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/render/backward_kit.h"
#include "train/base/fixed.h"
#include "train/base/stage.h"
#include "train/model/model.h"
#include "train/photographs/gallery.h"
#include "train/terms/terms.h"

enum { CALLS = 8, GROUPS = 3 };
static struct {
    const char *what[CALLS]; /* in the order of calls */
    bool fresh[CALLS];
    size_t n, opened, closed;
} seen;

static void note(const char *what, bool fresh)
{
    assert_true(seen.n < CALLS);
    seen.what[seen.n] = what;
    seen.fresh[seen.n++] = fresh;
}

/* ---- a toy term on Gaussians: it pulls on the first plane ---- */

static bool toy_wanted(const struct gallery *g)
{
    return g->cfg->scale_weight > 0.0;
}

static bool toy_acts(const struct gallery *g, const struct stage *at)
{
    (void)g;
    return at->step > 1;
}

static enum err_code toy_open(const struct gallery *g, const struct site *site, void **own,
                              struct err *e)
{
    (void)g;
    (void)site;
    (void)e;
    seen.opened++;
    *own = mem_array(1, 1);
    return *own ? ERR_OK : ERR_MEM;
}

static void toy_close(void *own)
{
    seen.closed++;
    mem_free(own);
}

static enum err_code toy_run(void *own, const struct term_step *s, struct err *e)
{
    float v[GROUPS * LAYOUT_PLANES_SHAPE * LAYOUT_LANES] = {0};
    enum err_code rc = s->fresh ? ERR_OK : dev_read(s->model->dev, s->extra, 0, sizeof v, v, e);
    assert_non_null(own);
    note("toy", s->fresh);
    for (size_t g = 0; g < GROUPS; g++)
        for (size_t lane = 0; lane < LAYOUT_LANES; lane++)
            v[g * LAYOUT_PLANES_SHAPE * LAYOUT_LANES + lane] +=
                (float)s->gallery->cfg->scale_weight;
    return rc ? rc : dev_write(s->model->dev, s->extra, 0, sizeof v, v, e);
}

static enum err_code colour_run(void *own, const struct term_step *s, struct err *e)
{
    (void)own;
    (void)s;
    (void)e;
    note("colour", false);
    return ERR_OK;
}

static enum err_code ray_hand_over(void *own, const struct term_step *s, struct err *e)
{
    (void)own;
    (void)s;
    (void)e;
    note("hand over", false);
    return ERR_OK;
}

static enum err_code ray_run(void *own, const struct term_step *s, struct err *e)
{
    (void)own;
    (void)s;
    (void)e;
    note("ray", false);
    return ERR_OK;
}

static const struct term_pass toy = {TERM_GAUSSIANS, toy_wanted, toy_open, toy_close,
                                     toy_acts,       NULL,       toy_run},
                              colour = {TERM_PIXELS, toy_wanted, NULL,      NULL,
                                        toy_acts,    NULL,       colour_run},
                              ray = {TERM_RAYS, toy_wanted,    NULL,   NULL,
                                     toy_acts,  ray_hand_over, ray_run};
static const struct term_pass *const rows[] = {&toy, &toy, &colour, &ray};
static const struct terms_list list = {rows, sizeof rows / sizeof *rows};

static void expect_calls(const char *const *what, size_t n)
{
    assert_int_equal(seen.n, n);
    for (size_t i = 0; i < n; i++)
        assert_string_equal(seen.what[i], what[i]);
}

static void a_row_is_a_term(void **state)
{
    static const char *const all[] = {"hand over", "toy", "toy", "colour", "ray"};
    struct train_config cfg = {.scale_weight = 0.5};
    struct gallery gallery = {.cfg = &cfg};
    struct site site = {0};
    struct stage at = {.step = 2};
    struct model model = {.dev = dev_get()};
    struct terms *terms = NULL;
    struct err e = {0};
    model.gauss.cap = model.gauss.n = GROUPS * LAYOUT_LANES;
    model.seen.groups = GROUPS;
    const struct term_step s = {.gallery = &gallery, .site = &site, .at = &at, .model = &model};
    kit_ok(terms_open_list(&terms, &list, &gallery, &site, &e), e);
    assert_int_equal(seen.opened, 2);
    kit_ok(terms_hand_over(terms, &s, &e), e);
    kit_ok(terms_before(terms, &s, &e), e);
    kit_ok(terms_after(terms, &s, &e), e);
    kit_ok(terms_backward(terms, &s, &e), e);
    expect_calls(all, sizeof all / sizeof *all);
    assert_true(seen.fresh[1] && !seen.fresh[2]); /* the second adds to what the first wrote */
    float *got = floats_read(model.adam.extra_grad, (size_t)LAYOUT_PLANES_SHAPE * LAYOUT_LANES);
    assert_true(got[0] == 1.0f && got[LAYOUT_LANES] == 0.0f);
    mem_free(got);
    /* Before they act, and with options that do not want them, nothing is run or opened. */
    seen.n = 0;
    at.step = 1;
    kit_ok(terms_hand_over(terms, &s, &e), e);
    kit_ok(terms_before(terms, &s, &e), e);
    kit_ok(terms_after(terms, &s, &e), e);
    assert_int_equal(seen.n, 0);
    assert_null(model.adam.extra_grad);
    terms_free(&terms);
    assert_int_equal(seen.closed, 2);
    cfg.scale_weight = 0.0;
    at.step = 2;
    kit_ok(terms_open_list(&terms, &list, &gallery, &site, &e), e);
    kit_ok(terms_before(terms, &s, &e), e);
    assert_int_equal(seen.opened + seen.n, 2);
    terms_free(&terms);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(a_row_is_a_term)};
    int failed = cmocka_run_group_tests(tests, NULL, NULL);
    dev_close(dev_get());
    return failed;
}
