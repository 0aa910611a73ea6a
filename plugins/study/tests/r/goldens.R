# What R says of four small studies: `Rscript goldens.R` writes goldens.json beside it, with the versions that it used.
suppressMessages({library(lme4); library(jsonlite)})
set.seed(3)

study <- function(people, scenes, styles, each, shift) {
  pairs <- expand.grid(scene = seq_len(scenes) - 1, style = seq_len(styles) - 1)
  rows <- do.call(rbind, lapply(seq_len(people) - 1, function(p) {
    item <- sort(sample(nrow(pairs), each)) - 1
    data.frame(participant = p, item = item, scene = pairs$scene[item + 1], style = pairs$style[item + 1])
  }))
  a <- rnorm(people, 0, 0.6); b <- rnorm(scenes, 0, 0.7); c <- rnorm(styles, 0, 0.7); d <- rnorm(nrow(pairs), 0, 0.4)
  latent <- shift + a[rows$participant + 1] + b[rows$scene + 1] + c[rows$style + 1] + d[rows$item + 1]
  rows$position <- sample(c(-1, 1), nrow(rows), TRUE)
  rows$deviation <- pmin(pmax(round(latent + 0.2 * rows$position + rnorm(nrow(rows))), -2), 2)
  rows
}

crossed <- function(rows) {
  model <- lmer(deviation ~ 1 + (1 | participant) + (1 | scene) + (1 | style) + (1 | item), rows)
  variances <- as.data.frame(VarCorr(model))
  list(mean = fixef(model)[[1]], error = sqrt(vcov(model)[1, 1]),
       components = as.list(setNames(variances$vcov, variances$grp)))
}

plain <- function(values) {
  lapply(c(less = "less", greater = "greater", two.sided = "two.sided"), function(alternative) {
    t <- t.test(values, alternative = alternative)
    w <- suppressWarnings(wilcox.test(values, alternative = alternative, exact = FALSE, correct = FALSE))
    list(t = t$statistic[[1]], t_p = t$p.value, t_interval = as.numeric(t$conf.int), w = w$statistic[[1]], w_p = w$p.value)
  })
}

distinct <- round(rnorm(14, -0.4), 6)
exact <- wilcox.test(distinct, conf.int = TRUE, exact = TRUE)
complete <- study(12, 5, 5, 25, -0.3)
incomplete <- study(34, 6, 5, 8, -0.4)
studies <- lapply(list(complete = complete, incomplete = incomplete), function(rows) {
  means <- tapply(rows$deviation, rows$participant, mean)
  list(rows = rows, crossed = crossed(rows), participants = plain(as.numeric(means)), responses = plain(rows$deviation))
})
result <- list(
  versions = list(R = R.version.string, lme4 = as.character(packageVersion("lme4"))),
  exact = list(values = distinct, p = exact$p.value, w = exact$statistic[[1]], median = exact$estimate[[1]],
               interval = as.numeric(exact$conf.int)),
  studies = studies)
write(toJSON(result, auto_unbox = TRUE, digits = 12, dataframe = "columns"), "goldens.json")
